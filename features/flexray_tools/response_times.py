"""Worst-case response times of frames: from a request to the last bit of the frame.

Dynamic frames: Pop, Pop, Eles, Peng and Andrei, "Timing analysis of the FlexRay communication
protocol", Real-Time Systems 39 (2008): R = sigma + w + C. A request that has just missed its slot
waits for the next of its cycles, then for all cycles that frames with lower IDs can fill, then for
the lower IDs in its own cycle. The number of filled cycles is a covering problem: exact by an
integer program while it is small, bounded from above otherwise.

A message buffer holds the newest value: a request that meets a waiting one is sent with it. The
response is that of the oldest request of a transmission.

A node with frames of several urgency classes sends those of one class in a cycle. As a rival it
counts once in a cycle, with its longest class. Its own other classes are no rivals, but once it has
sent in one of them, a request waits for the next cycle.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot

MOST_FILLED_CYCLES = 256
MOST_EXACT_VARIABLES = 200
_EXACT_NODES = 2000
_ROUNDING = 1e-9


class FrameResponse(NamedTuple):
    """The bound of a frame: `worst_us` from request to last bit, None where no bound was found.

    `filled_cycles` of its own cycles pass while lower IDs leave it no room. `exact` says that the
    integer program, not the relaxation, gave their number.
    """

    slot: MessageSlot
    worst_us: float | None
    filled_cycles: int
    exact: bool


class _Dynamic(NamedTuple):
    """A dynamic frame in minislots: place of its slot when nothing is sent before it, last minislot
    in which it may begin, minislots beyond that of an empty slot, and largest delay to its start.
    """

    slot: MessageSlot
    place: int
    latest: int
    extra: int
    period_us: float
    delay_us: float | None


class ResponseTimes:
    """Bounds of all frames of a slot table on a cluster."""

    def __init__(self, cluster: Cluster, slots: Sequence[MessageSlot]) -> None:
        self._cluster = cluster
        self._slots = sorted(slots, key=lambda slot: (slot.frame_id, slot.base_cycle))

    @cached_property
    def responses(self) -> tuple[FrameResponse, ...]:
        """The bounds in order of frame IDs and base cycles."""
        found: list[FrameResponse] = []
        lower: list[_Dynamic] = []
        for slot in self._slots:
            if slot.frame_id <= self._cluster.static_slots:
                found.append(self._static(slot))
                continue
            # A request meets frames of its own channels alone; a frame ID does not delay itself.
            frame = self._dynamic(slot)
            rivals = [
                other
                for other in lower
                if other.slot.frame_id < slot.frame_id
                and set(other.slot.channel) & set(slot.channel)
                and not is_alternative(other.slot, slot)
            ]
            rivals = _one_class_each(rivals)
            response, delay_us = self._bounded(frame, rivals)
            found.append(response)
            lower.append(frame._replace(delay_us=delay_us))
        return tuple(found)

    def _static(self, slot: MessageSlot) -> FrameResponse:
        """A request that has just missed its slot waits for the next of its cycles.

        Requests with an offset come at known times, whose responses repeat with the cycle counter
        where a period is a whole number of cycles.
        """
        cluster = self._cluster
        cycles = (slot.period_us or 0.0) / cluster.cycle_us
        if slot.offset_us is not None and abs(cycles - round(cycles)) < _ROUNDING:
            period_us = round(cycles) * cluster.cycle_us
            requests_us = [
                slot.offset_us + turn * period_us for turn in range(cluster.number_of_cycles)
            ]
            known_us = max(self._static_response_us(slot, one) for one in requests_us)
            return FrameResponse(slot, known_us, 0, True)
        wait_us = slot.repetition * cluster.cycle_us + cluster.action_point_us
        frame_us = cluster.frame_us(cluster.static_payload_bytes)
        return FrameResponse(slot, wait_us + frame_us, 0, True)

    def _static_response_us(self, slot: MessageSlot, request_us: float) -> float:
        """Return the time from a request to the end of the next static slot."""
        cluster = self._cluster
        slot_us = cluster.slot_start_us(slot.frame_id)
        cycles = (request_us - slot_us) / cluster.cycle_us - slot.base_cycle - _ROUNDING
        turns = max(0, math.ceil(cycles / slot.repetition))
        begin_us = (slot.base_cycle + turns * slot.repetition) * cluster.cycle_us + slot_us
        frame_us = cluster.action_point_us + cluster.frame_us(cluster.static_payload_bytes)
        return begin_us + frame_us - request_us

    def _dynamic(self, slot: MessageSlot) -> _Dynamic:
        cluster = self._cluster
        minislots = cluster.dynamic_slot_minislots(slot.payload_bytes)
        latest = last_minislot(slot, cluster)
        place = slot.frame_id - cluster.static_slots
        period_us = slot.period_us or slot.repetition * cluster.cycle_us
        return _Dynamic(slot, place, latest, minislots - 1, period_us, None)

    def _bounded(
        self, frame: _Dynamic, rivals: Sequence[_Dynamic]
    ) -> tuple[FrameResponse, float | None]:
        """Return the bound of a frame, and the largest delay from a request to its start."""
        cluster, slot = self._cluster, frame.slot
        if frame.place > frame.latest:
            return FrameResponse(slot, None, 0, True), None
        filled, exact = 0, True
        for phase in range(cluster.number_of_cycles // slot.repetition):
            count, sure = self._filled(frame, rivals, phase)
            if count > filled:
                filled, exact = count, sure
            elif count == filled:
                exact = exact and sure
            if filled >= MOST_FILLED_CYCLES:
                return FrameResponse(slot, None, filled, False), None
            if all(rival.slot.repetition <= slot.repetition for rival in rivals):
                break
        behind = min(frame.place + self._most_before(frame, rivals), frame.latest)
        wait_us = (filled + 1) * slot.repetition * cluster.cycle_us
        # A node that has sent in a class before this one sends no more in that cycle.
        missed = min(
            (
                one.frame_id - cluster.static_slots
                for one in self._slots
                if one.frame_id > cluster.static_slots and is_alternative(one, slot)
            ),
            default=frame.place,
        )
        delay_us = wait_us + (behind - min(missed, frame.place)) * cluster.minislot_us
        end_us = cluster.minislot_action_point_us + cluster.frame_us(slot.payload_bytes)
        return FrameResponse(slot, delay_us + end_us, filled, exact), delay_us

    def _filled(self, frame: _Dynamic, rivals: Sequence[_Dynamic], phase: int) -> tuple[int, bool]:
        """Most consecutive cycles of a frame, from a phase on, that rivals can fill, and whether
        the last answer is exact."""
        need = frame.latest - frame.place + 1
        repetition, base = frame.slot.repetition, frame.slot.base_cycle
        count, exact = 0, True
        while count < MOST_FILLED_CYCLES:
            cycles = base + repetition * (phase + np.arange(count + 1))
            open_to = np.array(
                [cycles % one.slot.repetition == one.slot.base_cycle for one in rivals], dtype=bool
            ).reshape(len(rivals), len(cycles))
            times = np.array(
                [
                    min(self._times(one, count * repetition), int(open_to[i].sum()))
                    for i, one in enumerate(rivals)
                ],
                dtype=int,
            )
            extra = np.minimum([one.extra for one in rivals], need)
            possible, exact = _coverable(extra, times, open_to, need)
            if not possible:
                return count, exact
            count += 1
        return count, False

    def _most_before(self, frame: _Dynamic, rivals: Sequence[_Dynamic]) -> int:
        """Most minislots that rivals add in one cycle of a frame."""
        slot = frame.slot
        cycles = np.arange(slot.base_cycle, self._cluster.number_of_cycles, slot.repetition)
        sent = [
            rival.extra * (cycles % rival.slot.repetition == rival.slot.base_cycle)
            for rival in rivals
        ]
        return int(np.sum(sent, axis=0).max()) if sent else 0

    def _times(self, rival: _Dynamic, cycles: int) -> int:
        """Most transmissions of a rival in slots that are so many cycles apart.

        Its requests are a period apart at least, and each waits `delay_us` at most.
        """
        if rival.delay_us is None:
            return cycles + 1
        spread_us = (rival.latest - rival.place) * self._cluster.minislot_us
        span_us = cycles * self._cluster.cycle_us + spread_us + rival.delay_us
        return 1 + int(span_us / rival.period_us + 1e-9)


def last_minislot(slot: MessageSlot, cluster: Cluster) -> int:
    """Return the last minislot in which a frame may begin, so that it ends in the segment."""
    own = slot.latest_transmission_minislot
    latest = cluster.latest_transmission_minislot if own is None else own
    return min(latest, cluster.minislots - cluster.dynamic_slot_minislots(slot.payload_bytes) + 1)


def is_alternative(one: MessageSlot, other: MessageSlot) -> bool:
    """Return whether a node never sends both of these dynamic frames in one cycle."""
    return one.node == other.node and one.urgency_class != other.urgency_class


def _one_class_each(rivals: Sequence[_Dynamic]) -> list[_Dynamic]:
    """Return rivals with one entry for each node that has frames of several classes.

    The entry has the minislots of the node's longest class, and may be sent in each of its cycles.
    Frames in different cycles or on different channels stay rivals of their own.
    """
    classes: dict[int, dict[int, list[_Dynamic]]] = {}
    for one in rivals:
        classes.setdefault(one.slot.node, {}).setdefault(one.slot.urgency_class, []).append(one)
    found: list[_Dynamic] = []
    for of_node in classes.values():
        frames = [one for of_class in of_node.values() for one in of_class]
        ways = {(one.slot.channel, one.slot.base_cycle, one.slot.repetition) for one in frames}
        if len(of_node) == 1 or len(ways) > 1:
            found += frames
            continue
        longest = max(of_node.values(), key=lambda of_class: sum(one.extra for one in of_class))
        extra = sum(one.extra for one in longest)
        found.append(longest[0]._replace(extra=extra, delay_us=None))
    return found


def _coverable(
    extra: np.ndarray, times: np.ndarray, open_to: np.ndarray, need: int
) -> tuple[bool, bool]:
    """Whether frames can fill every cycle by `need` minislots, and whether the answer is exact.

    `extra` (J,) minislots of each frame, which is sent `times` (J,) in all and once at most in each
    cycle that is `open_to` it (J, K). "No" is always exact.
    """
    frames, cycles = open_to.shape
    if not frames or (extra @ open_to < need).any() or extra @ times < need * cycles:
        return False, True
    if (times >= open_to.sum(axis=1)).all():
        return True, True
    if open_to.size > MOST_EXACT_VARIABLES:
        return True, False
    most: Any = times
    # scipy takes longer to load than commands that compute no bounds take to run.
    from scipy.optimize import Bounds, LinearConstraint, milp

    budget = LinearConstraint(np.kron(np.eye(frames), np.ones(cycles)), ub=most)
    cover = LinearConstraint(np.kron(extra, np.eye(cycles)), lb=need)
    allowed: Any = open_to.ravel().astype(float)
    solved: Any = milp(
        np.zeros(frames * cycles),
        integrality=np.ones(frames * cycles),
        bounds=Bounds(0, allowed),
        constraints=[budget, cover],
        options={"node_limit": _EXACT_NODES},
    )
    if solved.status == 2:
        return False, True
    return True, solved.status == 0
