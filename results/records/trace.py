"""A run as arrays: what its recording says, step by step."""

from collections.abc import Container, Iterable
from typing import NamedTuple

import numpy as np

from concord.filters.linalg import unpack_upper
from concord.nodes.changes import Event
from concord.nodes.history import History, history_of, with_holes, without_lost_words
from concord.nodes.messages import Bid, Estimate, Grant, Measured, Timing, Truth, from_wire
from concord.results.bus.bus_record import BusRecord
from concord.results.bus.sent_shares import SentShares
from concord.results.records.extras import Past, RunExtra, run_extras
from concord.results.records.record_spread import RecordSpread, record_spread
from concord.runtime.recorded import SharedFrame, meaning
from concord.runtime.recording import DAMAGE
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.catalogue import beside_truth
from concord.scenarios.preparation import with_settings
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import MeasurementFlooding, smoothing_lags

Places = Container[tuple[int, int]]
"""Steps and nodes of messages."""


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
    nodes = setup.scenario.nodes
    truths: dict[int, Truth] = {}
    measured: dict[tuple[int, int], Measured] = {}
    estimates: dict[tuple[int, int], Estimate] = {}
    on_bus = BusRecord(nodes)
    events: list[Event] = []
    timed, frames, damaged_bytes = False, frame_format(setup.scenario), 0
    for topic, data in messages:
        damaged_bytes += int(data) if topic == DAMAGE else 0
        match meaning(topic, data, nodes, frames):
            case SharedFrame(node, fragment):
                on_bus.note_frame(node, fragment, len(data) - frames.overhead_bytes)
            case Truth() as message:
                truths[message.step] = message
            case Bid() as message:
                on_bus.note_bid(message)
            case Grant() as message:
                on_bus.note_grant(message)
            case Measured() as message:
                measured[message.step, message.node] = message
            case Estimate() as message:
                estimates[message.step, message.node] = message
            case Event() as message:
                events.append(message)
            case Timing():
                timed = True
    history = without_lost_words(history_of(setup.scenario.rounds, events), estimates)
    if timed or damaged_bytes:
        # Only then does a step count that lacks a message, its truth included.
        steps = 1 + max((step for step, _ in estimates), default=-1)
        history = with_holes(history, estimates.keys() & measured.keys(), nodes, steps)
    else:
        steps = _whole_steps(history, nodes, truths, measured, estimates)
    trace = _assemble(setup, history, steps, truths, measured, estimates, on_bus)
    return trace._replace(damaged_bytes=damaged_bytes)


def _whole_steps(history: History, nodes: int, truths: Container[int], *kept: Places) -> int:
    """Return the number of steps with a truth and, in each of `kept`, a message of each member;
    also where all nodes are out in the last steps."""
    steps = 0
    while steps in truths and all(
        (steps, node) in places
        for places in kept
        for node in range(nodes)
        if history.is_in(node, steps)
    ):
        steps += 1
    return steps


def _assemble(
    setup: Setup,
    history: History,
    steps: int,
    truths: dict[int, Truth],
    measured: dict[tuple[int, int], Measured],
    estimates: dict[tuple[int, int], Estimate],
    on_bus: BusRecord,
) -> Trace:
    nodes, n = setup.scenario.nodes, len(setup.prior_mean)
    mean = np.full((steps, nodes, n), np.nan)
    packed = np.full((steps, nodes, n * (n + 1) // 2), np.nan)
    ages = np.full((steps, nodes, nodes), -1)
    past, suspect = _nothing(setup, steps), np.zeros((steps, nodes), dtype=bool)
    estimate_age_s, gap = np.full((2, steps, nodes), np.nan)
    delivered = [from_wire(measured[k, i].readings) for k, i in sorted(measured)[:1]]
    readings = np.full((steps, nodes, *(delivered[0].shape if delivered else (0, 0))), np.nan)
    counters: list[dict[str, int]] = [{} for _ in range(nodes)]
    controls: list[list[float] | None] = [None] * steps
    neighbours = {
        drawn_by: with_settings(setup, dict(drawn_by)).neighbours
        for drawn_by in {epoch.drawn_by for epoch in history.epochs}
    }
    for k, i in np.ndindex(steps, nodes):
        if not history.is_in(i, k):
            continue
        estimate = estimates[k, i]
        mean[k, i], packed[k, i] = from_wire(estimate.mean), from_wire(estimate.cov)
        ages[k, i, i] = 0
        ages[k, i, neighbours[history.drawn_by(k)][i]] = estimate.ages
        counters[i], suspect[k, i] = estimate.counters, estimate.suspect
        estimate_age_s[k, i] = np.nan if estimate.age_s is None else estimate.age_s
        gap[k, i] = np.nan if estimate.gap is None else estimate.gap
        if past is not None and estimate.smoothed and estimate.smoothed_std:
            past.mean[k, :, i] = from_wire(estimate.smoothed)
            past.std[k, :, i] = from_wire(estimate.smoothed_std)
        readings[k, i] = from_wire(measured[k, i].readings)
        controls[k] = measured[k, i].control
    truth = np.full((steps, len(setup.initial_state)), np.nan)
    for k in truths.keys() & range(steps):
        truth[k] = from_wire(truths[k].state)
    mean = beside_truth(setup.scenario, mean, truth[:, None, :n])
    extra, extras = None, run_extras(setup.scenario)
    if extras is not None:
        told = {(k, i): one.tracks for (k, i), one in estimates.items() if history.is_in(i, k)}
        extra = extras.read(setup, truth, told)
    return Trace(
        truth=truth if extra is None else truth[:, :n],
        readings=readings,
        control=_control(controls),
        mean=mean,
        cov=unpack_upper(packed),
        ages=ages,
        payload_bytes=on_bus.payload_bytes(history, steps),
        asked=on_bus.asked(history, steps),
        classes=on_bus.classes(history, steps),
        cut=on_bus.cut(history, steps),
        counters=counters,
        history=history,
        spread=(
            record_spread(setup, on_bus.whole_shares(), readings)
            if steps and not history.changed
            else None
        ),
        past=past,
        suspect=suspect if isinstance(setup.scenario.rule, MeasurementFlooding) else None,
        estimate_age_s=None if np.isnan(estimate_age_s).all() else estimate_age_s,
        extra=extra,
        duality_gap=None if np.isnan(gap).all() else gap,
    )


def _control(told: list[list[float] | None]) -> np.ndarray | None:
    """Controls (steps, p), NaN where none was told; None where none ever was."""
    sizes = [len(one) for one in told if one is not None]
    if not sizes:
        return None
    return np.array([np.full(max(sizes), np.nan) if one is None else one for one in told])


def _nothing(setup: Setup, steps: int) -> Past | None:
    """Return the past of a network that has estimated none yet."""
    lags = smoothing_lags(setup.scenario.rule)
    if not lags:
        return None
    shape = (steps, lags, setup.scenario.nodes, len(setup.prior_mean))
    return Past(np.full(shape, np.nan), np.full(shape, np.nan))
