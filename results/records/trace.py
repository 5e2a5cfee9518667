"""A run as arrays: what its recording says, step by step."""

from collections.abc import Container, Iterable
from typing import NamedTuple

import numpy as np

from concord.filters.linalg import unpack_upper
from concord.nodes.history import History, history_of, with_holes, without_lost_words
from concord.results.bus.sent_shares import SentShares
from concord.results.records.extras import Past, RunExtra, run_extras
from concord.results.records.heard_messages import HeardMessages
from concord.results.records.record_spread import RecordSpread, record_spread
from concord.results.records.step_rows import StepRows
from concord.scenarios.catalogue import beside_truth
from concord.scenarios.preparation import with_settings
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import MeasurementFlooding, smoothing_lags


class Trace(NamedTuple):
    """Histories of a run of N nodes, cut to the `steps` that every participating node completed; in
    real time to those that a node completed.

    While a node was out, its entries are NaN, its ages -1, and it sent nothing. So they are in real
    time where its estimate was late.

    Attributes:
        truth: (steps, n), NaN where it is unknown. readings: (steps, N, r, d), NaN where a node
        took none. control: (steps, p) that drove the plant into a step, or None for a plant that is
        not driven. mean, cov: estimates (steps, N, n) and (steps, N, n, n). ages: cycles since what
        i holds of j was sent: (steps, N, N), -1 never, 0 for itself. payload_bytes: (steps, rounds,
        N), what a node sent in a communication cycle, all its frames together; 0 where it was
        silent. asked: (steps, rounds, N), which node asked for the dynamic segment. classes:
        (steps, rounds, N), the urgency class in whose frame ID a node sent; else 0. cut: (steps,
        rounds, N), whether only the first frames of a share were sent. counters: per
        node, totals at its last estimate. history: who took part when, and in how many rounds; a
        step with fewer than the most leaves the last ones empty. spread: of labelled records; None
        for rules without, and where the network changed. past: for rules that estimate it. suspect:
        (steps, N), which nodes say that their belief does not fit what they have heard.
        estimate_age_s: (steps, N), age of each estimate when it was sent; None but in real time.
        extra: what nodes tell beside their beliefs, of scenarios with `RunExtras`; then the truth
        is cut to the states of a belief. duality_gap: (steps, N), of sets that a programme found;
        None without. damaged_bytes: of the recording; a step that lacks a message is left out as in
        real time.
    """

    truth: np.ndarray
    readings: np.ndarray
    control: np.ndarray | None
    mean: np.ndarray
    cov: np.ndarray
    ages: np.ndarray
    payload_bytes: np.ndarray
    asked: np.ndarray
    classes: np.ndarray
    cut: np.ndarray
    counters: list[dict[str, int]]
    history: History
    spread: RecordSpread | None = None
    past: Past | None = None
    suspect: np.ndarray | None = None
    estimate_age_s: np.ndarray | None = None
    extra: RunExtra | None = None
    duality_gap: np.ndarray | None = None
    damaged_bytes: int = 0

    @property
    def steps(self) -> int:
        """Number of complete steps."""
        return len(self.truth)

    @property
    def sent(self) -> SentShares:
        """The shares that the nodes sent, (steps, rounds, N)."""
        return SentShares(self.payload_bytes, self.classes, self.cut if self.cut.any() else None)

    @property
    def published(self) -> np.ndarray:
        """Which node sent a share in which communication cycle (steps, rounds, N)."""
        return (self.payload_bytes > 0) & ~self.cut


def read_trace(setup: Setup, messages: Iterable[tuple[str, bytes]]) -> Trace:
    """The trace of recorded (topic, bytes); the order of messages does not matter."""
    heard = HeardMessages(setup)
    for topic, data in messages:
        heard.note(topic, data)
    scenario, recorded = setup.scenario, (heard.estimates, heard.measured)
    history = history_of(scenario.rounds, heard.events)
    history = without_lost_words(history, heard.estimates)
    if heard.timed or heard.damaged_bytes:
        # Only then does a step count that lacks a message, its truth included.
        steps = min(scenario.steps, heard.estimates.steps)
        for rows in recorded:
            history = with_holes(history, rows, scenario.nodes, steps)
    else:
        steps = _whole_steps(history, scenario.nodes, heard.truths, *recorded)
    return _assemble(setup, history, steps, heard)


def _whole_steps(history: History, nodes: int, truths: Container[int], *kept: StepRows) -> int:
    """Return the number of steps with a truth and, in each of `kept`, a message of each member;
    also where all nodes are out in the last steps."""
    steps = 0
    while steps in truths and all(
        (steps, node) in rows
        for rows in kept
        for node in range(nodes)
        if history.is_in(node, steps)
    ):
        steps += 1
    return steps


def _assemble(setup: Setup, history: History, steps: int, heard: HeardMessages) -> Trace:
    n, on_bus = len(setup.prior_mean), heard.on_bus
    there = history.presence(steps, setup.scenario.nodes)
    rows, read = heard.estimates.rows(there), heard.estimates.field
    readings = heard.measured.field("readings", heard.measured.rows(there))
    truth = np.full((steps, len(setup.initial_state)), np.nan)
    for k in heard.truths.keys() & range(steps):
        truth[k] = heard.truths[k]
    mean = beside_truth(setup.scenario, read("mean", rows), truth[:, None, :n])
    suspect, age_s, gap = read("suspect", rows) == 1, read("age_s", rows), read("gap", rows)
    extra, extras = None, run_extras(setup.scenario)
    if extras is not None:
        told = {(k, i): heard.tracks[k, i] for k, i in np.argwhere(there).tolist()}
        extra = extras.read(setup, truth, told)
    return Trace(
        truth=truth if extra is None else truth[:, :n],
        readings=readings,
        control=_control([heard.controls.get(k) for k in range(steps)]),
        mean=mean,
        cov=unpack_upper(read("cov", rows)),
        ages=_ages(setup, history, there, read("ages", rows)),
        payload_bytes=on_bus.payload_bytes(history, steps),
        asked=on_bus.asked(history, steps),
        classes=on_bus.classes(history, steps),
        cut=on_bus.cut(history, steps),
        counters=[heard.counters(i, there[:, i]) for i in range(setup.scenario.nodes)],
        history=history,
        spread=(
            record_spread(setup, on_bus.whole_shares(), readings)
            if steps and not history.changed
            else None
        ),
        past=_past(setup, heard.estimates, rows),
        suspect=suspect if isinstance(setup.scenario.rule, MeasurementFlooding) else None,
        estimate_age_s=None if np.isnan(age_s).all() else age_s,
        extra=extra,
        duality_gap=None if np.isnan(gap).all() else gap,
        damaged_bytes=heard.damaged_bytes,
    )


def _ages(setup: Setup, history: History, there: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Return the ages (steps, N, N) that nodes which are `there` (steps, N) tell of their
    neighbours, (steps, N, at most N)."""
    steps, nodes = there.shape
    ages = np.full((steps, nodes, nodes), -1)
    ends = (*(epoch.first_step for epoch in history.epochs[1:]), steps)
    for epoch, end in zip(history.epochs, ends, strict=True):
        neighbours = with_settings(setup, dict(epoch.drawn_by)).neighbours
        for i, j in enumerate(neighbours):
            of_node = told[epoch.first_step : end, i, : len(j)]
            ages[epoch.first_step : end, i, j] = np.nan_to_num(of_node, nan=-1)
    for i in range(nodes):
        ages[there[:, i], i, i] = 0
    return ages


def _control(told: list[list[float] | None]) -> np.ndarray | None:
    """Controls (steps, p), NaN where none was told; None where none ever was."""
    sizes = [len(one) for one in told if one is not None]
    if not sizes:
        return None
    return np.array([np.full(max(sizes), np.nan) if one is None else one for one in told])


def _past(setup: Setup, estimates: StepRows, rows: np.ndarray) -> Past | None:
    """Return the smoothed states; None for rules that estimate none."""
    if not smoothing_lags(setup.scenario.rule):
        return None
    told = (estimates.field(name, rows) for name in ("smoothed", "smoothed_std"))
    return Past(*(one.swapaxes(1, 2) for one in told))
