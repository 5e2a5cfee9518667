"""Whole steps into frames: what a network said about a step becomes what is drawn of it.

The order of messages within a step does not matter, and steps may be left out: what is told in
totals or in ages is true all the same.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from concord.bus.bus import Bus, Transmission
from concord.dashboard.frames.frame import BusCycle, LogEntry, NodeTraffic, StepFrame
from concord.dashboard.frames.network import AnnouncedChange, NetworkStatus, after_all, read_change
from concord.dashboard.frames.reading_filters import ReadingFilters
from concord.dashboard.frames.scores import fuse, score, with_errors
from concord.dashboard.frames.stage import Stage, restaged
from concord.dashboard.frames.told import StepContent, StepReader
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import unpack_upper
from concord.nodes.messages import Estimate, from_wire
from concord.runtime.whole_steps import WholeStep
from concord.scenarios.catalogue import beside_truth


class BusView:
    """Places the frames of a cycle on the bus of a run."""

    def __init__(self, bus: Bus, since: "tuple[BusView, int] | None" = None) -> None:
        """Count on from the cycles of another bus, which ends before this cycle of nodes."""
        self._bus, self._offset = bus, 0
        if since is not None:
            before, first = since
            self._offset = before.number(first) - bus.timebase.bus_cycle(first)

    def number(self, cycle: int) -> int:
        """Return the number of a cycle among all cycles of the run, also of buses before."""
        return self._bus.timebase.bus_cycle(cycle) + self._offset

    def cycle(self, cycle: int, sizes: Mapping[int, int], frame_ids: Mapping[int, int]) -> BusCycle:
        """A cycle in which each node sent so many payload bytes, all its frames together, of which
        one had this ID."""
        schedule = self._bus.schedule
        row = [sizes.get(node, 0) for node in range(schedule.nodes)]
        classes = [
            self._bus.urgency_class(node, cycle, frame_ids.get(node, 0))
            for node in range(schedule.nodes)
        ]
        frames = self._bus.transmissions(cycle, row, classes)
        silent = tuple(node for node in schedule.static_senders(cycle) if not row[node])
        return BusCycle(
            self._bus, cycle, self.number(cycle), tuple(sorted(frames, key=_when)), silent, sum(row)
        )


def _when(frame: Transmission) -> tuple[float, int]:
    return frame.start_us, frame.frame_id


def judged(
    cycles: Sequence[BusCycle],
    heard: np.ndarray,
    ages: np.ndarray,
    alive: np.ndarray,
    events: Iterable[LogEntry],
) -> tuple[BusCycle, ...]:
    """Return the cycles of a step with the frames that were missed and rejected.

    heard (H, 2): receiver and sender; ages (H,) of what the receiver holds after the step, in
    cycles, -1 of nothing; alive (N,): the nodes that take part.
    """
    receiver, sender = heard.T
    held = np.where(ages >= 0, cycles[-1].cycle - ages, -1)
    told: list[BusCycle] = []
    for cycle in cycles:
        sent = np.zeros(len(alive), dtype=bool)
        sent[[frame.node for frame in cycle.frames]] = True
        missed = sent[sender] & alive[receiver] & (held < cycle.cycle)
        told.append(cycle._replace(missed=tuple(np.unique(sender[missed]).tolist())))
    rejected = tuple(event.text for event in events if "rejected" in event.text)
    return (*told[:-1], told[-1]._replace(rejected=rejected))


# A restarted node tells nothing of the counters that died with it.
_COUNTED = ("sent", "heard", "missed")


class Assembler:
    """Takes steps in order and gives the frame of each."""

    def __init__(self, stage: Stage, network: NetworkStatus | None = None) -> None:
        """Begin with the first step, or in the middle with what is known of the network."""
        self._stage = stage
        everybody = frozenset(range(stage.nodes))
        self._network = network or NetworkStatus(everybody, (0, 0, stage.rounds))
        self._changes: list[AnnouncedChange] = []
        self._bus = BusView(stage.bus)
        self._events: list[LogEntry] = []
        self._last: int | None = None
        n, nodes = len(stage.setup.prior_mean), stage.nodes
        self._reader = StepReader(stage.setup, stage.bus.frame_format)
        self.filters = ReadingFilters(stage)
        self.filters.follow(self._network)
        self._own = None if stage.own is None else stage.own.begin(stage.setup)
        self._belief = Gaussian(np.full((nodes, n), np.nan), np.full((nodes, n, n), np.nan))
        self._zonotopes: list[np.ndarray | None] = [None] * nodes
        self._alive = np.ones(nodes, dtype=bool)
        self._ages = np.full(len(stage.heard), -1)
        self._weights = np.full(len(stage.heard), np.nan)
        self._counters: list[dict[str, int]] = [{} for _ in range(nodes)]
        self._rejection = [""] * nodes
        self._last_sent = np.full(nodes, -1)

    @property
    def stage(self) -> Stage:
        """Return the stage with the settings of the newest frame."""
        return self._stage

    @property
    def pending(self) -> list[LogEntry]:
        """Return what the log will tell of the changes that hold from a step after the newest."""
        return after_all(self._network, self._changes, self._stage.names)[1]

    def hear(self, event: bytes) -> None:
        """Apply an event of the network, which holds from the step that it names."""
        change = read_change(event)
        self._changes += [change] if change else []

    def frame(self, step: WholeStep) -> StepFrame | None:
        """Return the frame of a step later than all before; none without a truth."""
        told = self._reader.read(step)
        if told.truth is None or (self._last is not None and step.number <= self._last):
            return None
        self._apply_changes(step.number)
        if self._last is not None and step.number > self._last + 1:
            self._leave_out(step.number - self._last - 1)
        self._last = step.number
        return self._drawn(step.number, from_wire(told.truth.state), told)

    def _leave_out(self, steps: int) -> None:
        """Let so many steps pass of which nothing was heard."""
        self._last_sent[:] = -1
        self._ages += np.where(self._ages >= 0, steps * self._stage.rounds, 0)

    def _apply_changes(self, number: int) -> None:
        """Take over what holds from this step on."""
        due = [change for change in self._changes if change.step <= number]
        if not due:
            return
        self._changes = [change for change in self._changes if change.step > number]
        before = self._network.settings
        self._network, events = after_all(self._network, due, self._stage.names)
        self._events += events
        if self._network.settings is not before:
            since = self._network.anchor[:2]
            self._stage = restaged(self._stage, dict(self._network.settings), *since)
            self._bus = BusView(self._stage.bus, (self._bus, since[1]))
            self.filters.follow(self._network)
            # Under other settings nodes begin without shares, and perhaps with other neighbours.
            self._ages = np.full(len(self._stage.heard), -1)

    def _drawn(self, number: int, state: np.ndarray, told: StepContent) -> StepFrame:
        stage = self._stage
        # A plant may have more states than a belief, which come after these.
        truth = state[: len(stage.state_names)]
        numbers = self._network.cycles(number)
        cycles = tuple(
            self._bus.cycle(
                cycle,
                {node: size for (when, node), size in told.sizes.items() if when == cycle},
                {node: one for (when, node), one in told.frame_ids.items() if when == cycle},
            )
            for cycle in numbers
        )
        for cycle in cycles:
            senders = list({frame.node for frame in cycle.frames})
            self._last_sent[senders] = cycle.cycle
        self._take_estimates(number, told)
        self._belief = self._beside(truth, self._belief)
        central, nis = self.filters.add(number, told, self._belief, self._alive)
        central = None if central is None else self._beside(truth, central)
        extra = None
        if self._own is not None:
            extra, changes = self._own.add(state, told.estimates)
            self._events += [LogEntry(number, words) for words in changes]
        events, self._events = tuple(self._events), []
        alive = self._alive.copy()
        ages = self._ages.copy()
        fused = fuse(self._belief, alive)
        scores = score(stage, truth, self._belief, alive, fused, central)
        if stage.own is not None:
            scores = with_errors(scores, stage.own.errors(extra)[alive])
        return StepFrame(
            stage=stage,
            step=number,
            time_s=number * stage.setup.time_step_s,
            truth=truth,
            belief=self._belief,
            zonotopes=tuple(self._zonotopes),
            fused=fused,
            seen=_seen(told, stage.nodes),
            alive=alive,
            ages=ages,
            weights=self._weights,
            lost=self._lost(ages, alive, numbers[-1]),
            cut=self._cut(),
            traffic=self._traffic(),
            rejection=tuple(self._rejection),
            cycles=judged(cycles, stage.heard, ages, alive, events),
            scores=scores._replace(nis=nis),
            events=events,
            extra=extra,
        )

    def _beside(self, truth: np.ndarray, beliefs: Gaussian) -> Gaussian:
        """Beliefs (..., n) with angles on the turn next to the truth (n,)."""
        return Gaussian(beside_truth(self._stage.setup.scenario, beliefs.mean, truth), beliefs.cov)

    def _take_estimates(self, number: int, told: StepContent) -> None:
        mean, cov = self._belief.mean.copy(), self._belief.cov.copy()
        self._weights = np.full(len(self._stage.heard), np.nan)
        start = 0
        for node, neighbours in enumerate(self._stage.setup.neighbours):
            estimate = told.estimates.get(node)
            part = slice(start, start + len(neighbours))
            start += len(neighbours)
            self._note_life(number, node, estimate is not None)
            if estimate is None:
                known = self._ages[part] >= 0
                self._ages[part] += np.where(known, self._stage.rounds, 0)
                continue
            mean[node] = from_wire(estimate.mean)
            cov[node] = unpack_upper(from_wire(estimate.cov))
            self._zonotopes[node] = _generators(estimate, mean.shape[-1])
            if len(estimate.ages) == len(neighbours):
                self._ages[part] = estimate.ages
            if estimate.weights is not None and len(estimate.weights) == len(neighbours):
                self._weights[part] = from_wire(estimate.weights)
            self._note_rejections(number, node, estimate.counters)
            self._counters[node] = estimate.counters
        self._belief = Gaussian(mean, cov)

    def _note_life(self, number: int, node: int, lives: bool) -> None:
        if lives == self._alive[node]:
            return
        self._alive[node] = lives
        # The network announces its members; a node that dies unannounced is entered here.
        if any(event.node == node for event in self._events):
            return
        what = "is back" if lives else "is down"
        self._events.append(
            LogEntry(number, f"node {self._stage.names[node]} {what}", node, not lives)
        )

    def _note_rejections(self, number: int, node: int, counters: dict[str, int]) -> None:
        before = self._counters[node]
        for name, total in counters.items():
            if name.startswith("rejected") and total > before.get(name, 0):
                reason = name.removeprefix("rejected ")
                self._rejection[node] = reason
                text = f"node {self._stage.names[node]} rejected a frame: {reason}"
                self._events.append(LogEntry(number, text, node, True))

    def _lost(self, ages: NDArray[np.int64], alive: np.ndarray, last_cycle: int) -> np.ndarray:
        """Whose newest share did not reach whom: what is held is older than what was sent."""
        receiver, sender = self._stage.heard.T
        sent = self._last_sent[sender]
        newest = last_cycle - sent
        return (sent >= 0) & alive[receiver] & (ages != newest)

    def _cut(self) -> np.ndarray:
        cut = self._network.cut
        return np.array(
            [(int(i), int(j)) in cut or (int(j), int(i)) in cut for i, j in self._stage.edges],
            dtype=bool,
        )

    def _traffic(self) -> NodeTraffic:
        def total(name: str) -> NDArray[np.int64]:
            return np.array([counters.get(name, 0) for counters in self._counters])

        rejected = [
            sum(count for name, count in counters.items() if name.startswith("rejected"))
            for counters in self._counters
        ]
        sent, heard, missed = (total(name) for name in _COUNTED)
        return NodeTraffic(sent, heard, missed, np.array(rejected))


def _generators(estimate: Estimate, states: int) -> np.ndarray | None:
    """The generators (n, q) that a node tells; None of what is no zonotope of so many states."""
    rows = estimate.generators
    if rows is None or len(rows) != states or len({len(row) for row in rows}) != 1:
        return None
    return from_wire(rows)


def _seen(told: StepContent, nodes: int) -> np.ndarray:
    seen = np.zeros(nodes, dtype=bool)
    for node, measured in told.measured.items():
        seen[node] = any(value is not None for row in measured.readings for value in row)
    return seen
