"""The batched driver: all nodes of many runs as arrays (runs, nodes, ...), step by step.

This driver does for environment, bus and nodes what `concord.nodes.environment` and
`concord.nodes.node` do by messages, with the same functions: run r has the numbers that the
in-process driver gives it to 1e-10. The driver passes no messages, so nothing can be late, repeated
or malformed.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.environment_state import Delivery
from concord.nodes.lanes.filter import Counters, added, with_lanes
from concord.nodes.lanes.links import places
from concord.nodes.lanes.network import (
    BatchedNetwork,
    BatchedRule,
    RuleWithCheck,
    RuleWithLengths,
    RuleWithPast,
    RuleWithReturns,
    RuleWithTracks,
    RunSegment,
    RunSettings,
    ShareContents,
)
from concord.nodes.messages import ReportedTracks
from concord.nodes.node import contenders_left
from concord.nodes.rules.lane_rule import NO_BID


class Tally(NamedTuple):
    """Totals (R, N) by name: those that are `shown`, and those of the rule as last `seen`.

    A rule counts on for nodes that are out; what is shown of them stays what it was.
    """

    shown: Counters
    seen: Counters

    def after(self, counters: Counters, frames: np.ndarray, present: np.ndarray) -> "Tally":
        """With a step more, in which nodes sent so many `frames` (R, N); `present` (N,) counted."""
        gained = {name: count - self.seen.get(name, 0) for name, count in counters.items()}
        gained["sent"] = frames
        gained = {name: np.where(present, count, 0) for name, count in gained.items()}
        return Tally(added(self.shown, gained), counters)

    def forgetting(self, nodes: np.ndarray) -> "Tally":
        """Nodes (J,) have come back, and count from nothing."""
        shown = {name: count.copy() for name, count in self.shown.items()}
        for count in shown.values():
            count[:, nodes] = 0
        return self._replace(shown=shown)


def masked(present: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (R, N, ...), NaN at nodes that are not `present` (N,)."""
    if present.all():
        return values
    return np.where(present.reshape(-1, *(1,) * (values.ndim - 2)), values, np.nan)


class Instant(NamedTuple):
    """Results of a step; for an absent node NaN, age -1, and nothing sent.

    truth: (R, n). readings: (R, N, r, d). control: (R, p) that drove into the step. belief: after
    the last round, (R, N, n), (R, N, n, n). ages: (R, E). payload_bytes, asked, classes: (rounds,
    R, N), of what a node sent in a cycle, whether it asked for the dynamic segment, and in which
    urgency class it won. counters: totals
    (R, N) by name, of a node that came back since then. spread: what shares carried, where they
    have no length of their own. past: (R, N, L, n), the states of 0, 1, ... steps ago, of a rule
    that estimates them. suspect: (R, N), of a rule whose nodes check themselves. tracks: of each
    node of each run, None of an absent one; None for a rule without.
    """

    step: int
    truth: np.ndarray
    readings: np.ndarray
    control: np.ndarray | None
    belief: Gaussian
    ages: np.ndarray
    payload_bytes: np.ndarray
    asked: np.ndarray
    classes: np.ndarray
    counters: Counters
    spread: ShareContents | None
    past: Gaussian | None
    suspect: np.ndarray | None
    tracks: list[list[ReportedTracks | None]] | None


class _Said(NamedTuple):
    """Publications in a step, or in a cycle of it: which nodes sent, which asked, and in which
    urgency class they won: (rounds, R, N)."""

    sends: np.ndarray
    asked: np.ndarray
    classes: np.ndarray


def run(network: BatchedNetwork) -> Iterator[Instant]:
    """The steps of all runs, one after the other."""
    plant, segments = network.plant, {segment.first_step: segment for segment in network.segments}
    truth, control, tally = network.initial_state, None, Tally({}, {})
    memory = network.controller.memory if network.controller else None
    deliver = _delivery(network.delivery, len(truth))
    segment = segments[0]
    content, arbiter = segment.settings.rule.start(network.prior), segment.settings.contest_memory
    for step in range(network.steps):
        if step > 0:
            believed = segment.settings.rule.belief(content)
            control, memory = _steer(network, segment, believed, truth, control, memory, step - 1)
            truth = plant.advance(truth, control, network.process[step - 1], step - 1)
            if step in segments:
                before, segment = segment, segments[step]
                content, arbiter, tally = _turned(before, segment, content, arbiter, tally)
        rule = segment.settings.rule
        readings = deliver(plant.observe(truth, network.measurement[step], step), step)
        # An absent node runs on and no node hears it, so that its numbers stay finite.
        content = rule.begin_step(content, readings, control, step)
        content, arbiter, sent = _communicated(segment, content, arbiter, step)
        spread = rule.spread(content)
        frames, payload = _framed(segment.settings, step, sent.sends, spread)
        tally = tally.after(rule.counters(content), frames, segment.present)
        here, heard = segment.present, segment.present[network.receivers]
        yield Instant(
            step,
            truth,
            masked(here, readings),
            control,
            Gaussian(*(masked(here, values) for values in rule.belief(content))),
            rule.ages(content) if heard.all() else np.where(heard, rule.ages(content), -1),
            payload,
            sent.asked,
            sent.classes,
            tally.shown,
            spread,
            _past(rule, content, here),
            rule.suspect(content) & here if isinstance(rule, RuleWithCheck) else None,
            _tracks(rule, content, here),
        )


def _past(rule: BatchedRule, content: Any, here: np.ndarray) -> Gaussian | None:
    """Smoothed states of the nodes that take part (N,)."""
    if not isinstance(rule, RuleWithPast):
        return None
    return Gaussian(*(masked(here, values) for values in rule.smoothed(content)))


def _tracks(
    rule: BatchedRule, content: Any, here: np.ndarray
) -> list[list[ReportedTracks | None]] | None:
    """Return the tracks of the nodes that take part (N,)."""
    if not isinstance(rule, RuleWithTracks):
        return None
    return [
        [one if is_here else None for one, is_here in zip(of_run, here, strict=True)]
        for of_run in rule.tracks(content)
    ]


def _turned(
    before: RunSegment, segment: RunSegment, content: Any, arbiter: Any, tally: Tally
) -> tuple[Any, Any, Tally]:
    """Return the rule's content, the arbiter's state, and the counters, as the segment begins."""
    nodes = np.array([node for node, _ in segment.joined], dtype=np.int64)
    sources = np.array([source for _, source in segment.joined], dtype=np.int64)
    believed = before.settings.rule.belief(content)
    told = Gaussian(believed.mean[:, sources], believed.cov[:, sources])
    tally = tally.forgetting(nodes)
    if segment.settings is not before.settings:
        content = segment.settings.rule.start(with_lanes(believed, nodes, told))
        return content, segment.settings.contest_memory, tally._replace(seen={})
    if len(nodes):
        rule = segment.settings.rule
        assert isinstance(rule, RuleWithReturns), "the scenario goes message by message"
        content = rule.restarted(content, nodes, told)
    return content, arbiter, tally


def _steer(
    network: BatchedNetwork,
    segment: RunSegment,
    belief: Gaussian,
    truth: np.ndarray,
    control: np.ndarray | None,
    memory: Any,
    last: int,
) -> tuple[np.ndarray | None, Any]:
    """Return the control from step `last` on (R, p), and the controller's memory."""
    if network.controller is None:
        return None, memory
    law, _, node = network.controller
    if node is not None and not segment.present[node]:
        # A node that is out leaves the actuator where it was.
        return control, memory
    return law(truth if node is None else belief.mean[:, node], memory, last)


def _delivery(delivery: Delivery | None, runs: int) -> Callable[[np.ndarray, int], np.ndarray]:
    """Return the delivery between sensors and nodes, with a memory for each run."""
    if delivery is None:
        return lambda readings, step: readings
    memories = [delivery.memory] * runs

    def deliver(readings: np.ndarray, step: int) -> np.ndarray:
        delivered = []
        for run_, taken in enumerate(readings):
            memories[run_], arrived = delivery.transmit(memories[run_], taken, step)
            delivered.append(arrived)
        return np.stack(delivered)

    return deliver


def _communicated(
    segment: RunSegment, content: Any, arbiter: Any, step: int
) -> tuple[Any, Any, _Said]:
    """Run all cycles of a step."""
    done: list[_Said] = []
    for cycle in segment.settings.cycles(step):
        lost = None if segment.lost is None else segment.lost(step, cycle)
        content, arbiter, in_cycle = _cycle(segment, content, arbiter, cycle, lost)
        done.append(in_cycle)
    return content, arbiter, _Said(*map(np.stack, zip(*done, strict=True)))


def _cycle(
    segment: RunSegment, content: Any, arbiter: Any, cycle: int, lost: np.ndarray | None
) -> tuple[Any, Any, _Said]:
    """Run a cycle, group by group; return what nodes did in it: (R, N) each."""
    rule, schedule = segment.settings.rule, segment.settings.schedule
    shape = rule.belief(content).mean.shape[:2]
    done = _Said(np.zeros(shape, bool), np.zeros(shape, bool), np.zeros(shape, np.int64))
    for number in range(len(schedule.groups(cycle))):
        arbiter, now = _access(segment, arbiter, content, (cycle, number), done.sends)
        content = rule.exchange(content, now.sends, lost)
        done = _Said(*(before | new for before, new in zip(done, now, strict=True)))
    return content, arbiter, done


def _access(
    segment: RunSegment, arbiter: Any, content: Any, place: tuple[int, int], spoke: np.ndarray
) -> tuple[Any, _Said]:
    """Return which nodes send in a group (cycle, group), which ask for its dynamic slots, and in
    which class they win.

    All are (R, N). No node sends twice in a cycle; nodes `spoke` (R, N) have sent already.
    """
    cycle, number = place
    schedule = segment.settings.schedule
    group = schedule.groups(cycle)[number]
    sends, asked = np.zeros((2, *spoke.shape), dtype=bool)
    classes = np.zeros(spoke.shape, dtype=np.int64)
    sends[:, places(group.senders)] = True
    sends &= segment.present
    contenders = places(contenders_left(schedule, cycle, ()))
    if group.dynamic_slots and len(contenders):
        rule = segment.settings.rule
        bids = rule.bids(content, contenders)
        silent = spoke[:, contenders] | ~segment.present[contenders]
        bids = np.where(silent, NO_BID, bids)
        lengths = partial(_lengths, rule, content, contenders)
        awards = segment.settings.contest(arbiter, cycle, number, contenders, bids, lengths)
        arbiter = awards.state
        asked[:, contenders] = bids != NO_BID
        sends[:, contenders] = awards.wins
        classes[:, contenders] = np.where(awards.wins, awards.classes, 0)
    return arbiter, _Said(sends, asked, classes)


def _lengths(rule: BatchedRule, content: Any, nodes: np.ndarray) -> np.ndarray | None:
    """Return the lengths (R, C) of what nodes (C,) would send; None where all have one length."""
    return rule.body_bytes(content, nodes) if isinstance(rule, RuleWithLengths) else None


def _framed(
    settings: RunSettings, step: int, sends: np.ndarray, spread: ShareContents | None
) -> tuple[np.ndarray, np.ndarray]:
    """Frames of a step (R, N), and bytes of payload in each cycle (rounds, R, N)."""
    bodies = [None] * len(sends) if spread is None else spread.body_bytes
    cycles = zip(settings.cycles(step), sends, bodies, strict=True)
    frames, payload = zip(*(settings.framed(*cycle) for cycle in cycles), strict=True)
    return np.sum(frames, axis=0), np.stack(payload)
