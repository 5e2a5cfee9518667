"""How labelled records spread in a run: what its frames carried, and who had which record when.

The recording says what was sent, and not what a link lost: arrivals are those of a bus without
loss, as every driver but a hostile test has it.
"""

from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

import msgspec
import numpy as np

from nodes.estimator import Rejected
from nodes.labelled import LabelledFlooding
from nodes.messages import Array
from nodes.share import Fragment, read_body
from scenarios.build import build_node
from scenarios.setup import Setup

NEVER = -1


class RecordSpread(NamedTuple):
    """The records of a run of N nodes.

    Attributes:
        taken: (steps, N), whether a node took a record at a step.
        arrival_steps: (N, steps, N), when node i came to hold what source j took at a step.
        window_steps: how late it may come to be of use.
        body_bytes: (steps,), what all nodes said in a step, without numbers, headers and padding.
        shares, checkpoints, records: how many were sent.
    """

    taken: np.ndarray
    arrival_steps: np.ndarray
    window_steps: int
    body_bytes: np.ndarray
    shares: int
    checkpoints: int
    records: int


class SpreadFigures(msgspec.Struct, frozen=True):
    """What the spread of records amounts to.

    Attributes:
        coverage: share of (record, other node) pairs in which it came within the window, of records
            whose window has passed; NaN where none has.
        lag_steps_mean, lag_steps_max: how much older the newest record of a source is at another
            node than at the source, over all steps.
        checkpoint_share: part of the shares that carry a checkpoint.
        records_per_share: on average.
        body_bytes_per_step: what all nodes say in a step, before frames are made of it.
    """

    coverage: float
    lag_steps_mean: float
    lag_steps_max: int
    checkpoint_share: float
    records_per_share: float
    body_bytes_per_step: float


def record_spread(
    setup: Setup, fragments: Iterable[tuple[int, Fragment]], readings: Array
) -> RecordSpread | None:
    """From what each node sent (node, fragment), and readings (steps, N, r, d); None for rules that
    send no records."""
    if setup.scenario.rule != "labelled":
        return None
    estimator = build_node(setup, 0).estimator
    if not isinstance(estimator, LabelledFlooding):
        return None
    taken = np.logical_not(np.isnan(readings)).any(axis=(2, 3))
    steps, nodes = readings.shape[:2]
    rounds = setup.scenario.rounds
    audience = [[i for i in range(nodes) if j in setup.neighbours[i]] for j in range(nodes)]
    arrival = np.full((nodes, steps, nodes), steps)
    for step, node in np.argwhere(taken):
        arrival[node, step, node] = step
    shares = _shares(fragments, steps * rounds)
    body_bytes = np.zeros(steps, dtype=int)
    checkpoints = records = 0
    for (cycle, sender), body in shares.items():
        step = cycle // rounds
        share = estimator.frames.decode(body)
        body_bytes[step] += len(body)
        checkpoints += share.checkpoint is not None
        records += len(share.records)
        for source, age, _ in share.records:
            heard = arrival[audience[sender], step - age, source]
            arrival[audience[sender], step - age, source] = np.minimum(heard, step)
    arrival[arrival == steps] = NEVER
    return RecordSpread(
        taken,
        arrival,
        estimator.frames.window_steps,
        body_bytes,
        len(shares),
        checkpoints,
        records,
    )


def figures_of(spread: RecordSpread) -> SpreadFigures:
    """The figures of a run with at least one share."""
    steps, nodes = spread.taken.shape
    others = ~np.eye(nodes, dtype=bool)[:, None, :]
    over = np.arange(steps) + spread.window_steps <= steps
    counted = others & (spread.taken & over[:, None])
    delay = spread.arrival_steps - np.arange(steps)[:, None]
    in_time = (spread.arrival_steps >= 0) & (delay < spread.window_steps)
    lags = _lags(spread)[np.broadcast_to(others, (nodes, steps, nodes))]
    lags = lags[lags >= 0]
    sent = max(spread.shares, 1)
    return SpreadFigures(
        coverage=float(in_time[counted].mean()) if counted.any() else float("nan"),
        lag_steps_mean=float(lags.mean()) if lags.size else float("nan"),
        lag_steps_max=int(lags.max(initial=0)),
        checkpoint_share=spread.checkpoints / sent,
        records_per_share=spread.records / sent,
        body_bytes_per_step=float(spread.body_bytes.mean()),
    )


def lines(figures: SpreadFigures) -> list[str]:
    """The figures in words."""
    coverage = "-" if np.isnan(figures.coverage) else f"{100 * figures.coverage:.2f} %"
    return [
        f"records: {coverage} arrived within the window; the newest of a source is "
        f"{figures.lag_steps_mean:.2f} steps behind it in the mean (most {figures.lag_steps_max}); "
        f"{figures.records_per_share:.1f} in a share, {100 * figures.checkpoint_share:.1f} % of the "
        f"shares with a checkpoint; {figures.body_bytes_per_step:.0f} bytes said per step"
    ]


def _shares(fragments: Iterable[tuple[int, Fragment]], cycles: int) -> dict[tuple[int, int], bytes]:
    """The body of each complete share in these cycles, by cycle and sender."""
    parts: dict[tuple[int, int], list[bytes]] = defaultdict(list)
    for node, fragment in fragments:
        if fragment.cycle < cycles:
            parts[fragment.cycle, node].append(fragment.data)
    return {key: body for key, data in sorted(parts.items()) if (body := _body(data)) is not None}


def _body(parts: list[bytes]) -> bytes | None:
    """What they say together; None where the recording has lost a part."""
    try:
        return read_body(parts)
    except Rejected:
        return None


def _lags(spread: RecordSpread) -> np.ndarray:
    """Steps (N, steps, N) by which the newest record is older at i than at its source j.

    -1 where the source has taken none, or i has heard of none of its records.
    """
    steps, nodes = spread.taken.shape
    numbers = np.arange(steps)
    own = np.maximum.accumulate(np.where(spread.taken, numbers[:, None], -1), axis=0)
    newest = np.full((nodes, steps, nodes), -1)
    for i, t, j in np.argwhere(spread.arrival_steps >= 0):
        came = spread.arrival_steps[i, t, j]
        newest[i, came, j] = max(newest[i, came, j], t)
    newest = np.maximum.accumulate(newest, axis=1)
    return np.where((newest >= 0) & (own >= 0), own - newest, -1)
