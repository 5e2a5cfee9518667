"""Spread of labelled records in a run: contents of its frames, and the records of each node.

The recording says what was sent; what a link lost follows from the scenario.
"""

from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

import msgspec
import numpy as np

from concord.bus.bus import Fragment, FrameFormat, Rejected
from concord.nodes.faults.losses import LinkState, hears_all
from concord.scenarios.build import build_node
from concord.scenarios.links import link_state
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import FloodingRule

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
    """Figures of the spread of records.

    Attributes:
        coverage: share of (record, other node) pairs in which it came within the window, of records
            whose window has passed; NaN where none has.
        delay_steps_mean, delay_steps_max: how long a record took to another node, if it came.
        age_steps_mean, age_steps_mean_at_source: age of the newest record of a source at other
            nodes, and at itself, over all steps from the first that came.
        age_steps_by_source: the former for each source; NaN for one of which nothing ever came.
        checkpoint_share: part of the shares that carry a checkpoint.
        records_per_share: on average.
        body_bytes_per_step: what all nodes say in a step, before frames are made of it.
    """

    coverage: float
    delay_steps_mean: float
    delay_steps_max: int
    age_steps_mean: float
    age_steps_mean_at_source: float
    age_steps_by_source: list[float]
    checkpoint_share: float
    records_per_share: float
    body_bytes_per_step: float


def record_spread(
    setup: Setup, fragments: Iterable[tuple[int, Fragment]], readings: np.ndarray
) -> RecordSpread | None:
    """From what each node sent (node, fragment), and readings (steps, N, r, d); None for rules that
    send no records."""
    if not isinstance(setup.scenario.rule, FloodingRule):
        return None
    # Only here: other rules need nothing of this one.
    from concord.nodes.rules.labelled.flooding import LabelledFlooding

    config = build_node(setup, 0)
    estimator = config.estimator
    if not isinstance(estimator, LabelledFlooding):
        return None
    taken = np.sum(~np.isnan(readings), axis=(2, 3)) > 0
    steps, nodes = readings.shape[:2]
    rounds = setup.scenario.rounds
    audience = [
        np.array([i for i in range(nodes) if j in setup.neighbours[i]], dtype=int)
        for j in range(nodes)
    ]
    links = link_state(setup)
    arrival = np.full((nodes, steps, nodes), steps)
    for step, node in np.argwhere(taken):
        arrival[node, step, node] = step
    shares = _shares(fragments, steps * rounds, config.bus.frame_format)
    body_bytes = np.zeros(steps, dtype=int)
    checkpoints = records = 0
    for (cycle, sender), (body, frames) in shares.items():
        step = cycle // rounds
        share = estimator.frames.decode(body)
        reached = _reached(links, step, cycle, sender, audience[sender], frames)
        body_bytes[step] += len(body)
        checkpoints += share.checkpoint is not None
        records += len(share.records)
        for source, age, _ in share.records:
            heard = arrival[reached, step - age, source]
            arrival[reached, step - age, source] = np.minimum(heard, step)
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
    """Return the figures of a run with at least one share."""
    steps, nodes = spread.taken.shape
    others = np.broadcast_to(~np.eye(nodes, dtype=bool)[:, None, :], spread.arrival_steps.shape)
    came = spread.arrival_steps >= 0
    delay = spread.arrival_steps - np.arange(steps)[:, None]
    ages = record_ages(spread)
    sent = max(spread.shares, 1)
    return SpreadFigures(
        coverage=_mean(in_time(spread)),
        delay_steps_mean=_mean(delay[others & came]),
        delay_steps_max=int(delay[others & came].max(initial=0)),
        age_steps_mean=_mean(ages[others & (ages >= 0)]),
        age_steps_mean_at_source=_mean(ages[~others & (ages >= 0)]),
        age_steps_by_source=[
            _mean(ages[:, :, source][(others & (ages >= 0))[:, :, source]])
            for source in range(nodes)
        ],
        checkpoint_share=spread.checkpoints / sent,
        records_per_share=spread.records / sent,
        body_bytes_per_step=float(spread.body_bytes.mean()),
    )


def in_time(spread: RecordSpread) -> np.ndarray:
    """Return whether a record came to another node within its window (pairs,), for each pair of
    another node and a record whose window has passed."""
    steps, nodes = spread.taken.shape
    others = ~np.eye(nodes, dtype=bool)[:, None, :]
    over = np.arange(steps) + spread.window_steps <= steps
    delay = spread.arrival_steps - np.arange(steps)[:, None]
    came = (spread.arrival_steps >= 0) & (delay < spread.window_steps)
    return came[others & (spread.taken & over[:, None])]


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


def lines(figures: SpreadFigures) -> list[str]:
    """Return the figures in words; what nothing is known of is named so."""
    parts = [
        "none was old enough yet to tell whether it arrived within the window"
        if np.isnan(figures.coverage)
        else f"{100 * figures.coverage:.2f} % arrived within the window",
        "none reached another node"
        if np.isnan(figures.delay_steps_mean)
        else f"an arrival took {figures.delay_steps_mean:.2f} steps in the mean (most "
        f"{figures.delay_steps_max}); the newest of a source is {figures.age_steps_mean:.2f} "
        f"steps old at others, {figures.age_steps_mean_at_source:.2f} at itself",
    ]
    return [
        f"records: {'; '.join(parts)}",
        f"shares: {figures.records_per_share:.1f} records in each, "
        f"{100 * figures.checkpoint_share:.1f} % with a checkpoint; "
        f"{figures.body_bytes_per_step:.0f} bytes said per step",
    ]


def _reached(
    links: LinkState, step: int, cycle: int, sender: int, audience: np.ndarray, frames: int
) -> np.ndarray:
    """Which of the audience (J,) all frames of a share reach."""
    when = (np.array(step), np.array(cycle), np.array(sender))
    heard = hears_all(links, *when, audience[:, None], np.arange(frames))
    return audience[heard.all(axis=1)]


def _shares(
    fragments: Iterable[tuple[int, Fragment]], cycles: int, frame_format: FrameFormat
) -> dict[tuple[int, int], tuple[bytes, int]]:
    """The body and number of frames of each complete share in these cycles, by cycle and sender."""
    parts: dict[tuple[int, int], list[bytes]] = defaultdict(list)
    for node, fragment in fragments:
        if fragment.cycle < cycles:
            parts[fragment.cycle, node].append(fragment.data)
    bodies = {key: (_body(data, frame_format), len(data)) for key, data in sorted(parts.items())}
    return {key: (body, frames) for key, (body, frames) in bodies.items() if body is not None}


def _body(parts: list[bytes], frame_format: FrameFormat) -> bytes | None:
    """Join the parts into one body; return None if the recording has lost a part."""
    try:
        return frame_format.join(parts)
    except Rejected:
        return None


def record_ages(spread: RecordSpread) -> np.ndarray:
    """Age in steps (N, steps, N) of the newest record of a source; -1 before the first."""
    steps, nodes = spread.taken.shape
    newest = np.full((nodes, steps, nodes), NEVER)
    for i, t, j in np.argwhere(spread.arrival_steps >= 0):
        came = spread.arrival_steps[i, t, j]
        newest[i, came, j] = max(newest[i, came, j], t)
    newest = np.maximum.accumulate(newest, axis=1)
    return np.where(newest == NEVER, -1, np.arange(steps)[:, None] - newest)
