"""Who wins the dynamic segment of a cycle: three arbiters, and the events on which nodes ask.

An arbiter is a pure function `(state, requests, *, cluster, slots) -> (state, winners)`: at most
`slots` requests win, all of them fit into the segment together, and they come back in the order of
the bus. The order in which requests are given does not matter.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol

from bus.cluster import Cluster
from bus.dynamic_segment import Request, walk

Trigger = Callable[[int], bool]
"""Whether a node asks for the dynamic segment, given the bid it would make."""


class ArbiterState(NamedTuple):
    """What an arbiter remembers: the last frame ID served (round robin), and how long who waits.

    `waits` holds (node, cycles in a row in which it asked and did not win), by node.
    """

    last_frame_id: int = 0
    waits: tuple[tuple[int, int], ...] = ()


class Arbiter(Protocol):
    """The face of `minislot`, `wtod` and `round_robin`. Raises ValueError as `walk` does."""

    def __call__(
        self, state: ArbiterState, requests: Iterable[Request], *, cluster: Cluster, slots: int
    ) -> tuple[ArbiterState, tuple[Request, ...]]: ...


def minislot(
    state: ArbiterState, requests: Iterable[Request], *, cluster: Cluster, slots: int
) -> tuple[ArbiterState, tuple[Request, ...]]:
    """FlexRay's own: the slot counter goes through the frame IDs, low ones first.

    A request that does not fit any more waits; high IDs can starve (`starving`).
    """
    pending = sorted(requests, key=lambda request: request.frame_id)
    waiting = set(walk(cluster, pending).waiting)
    winners = [request for request in pending if request not in waiting][:slots]
    return _conclude(state.last_frame_id, state, pending, winners)


def wtod(
    state: ArbiterState, requests: Iterable[Request], *, cluster: Cluster, slots: int
) -> tuple[ArbiterState, tuple[Request, ...]]:
    """Weighted try-once-discard: the largest bids win, ties go to the lowest frame ID.

    A request that does not fit beside larger bids is passed over.
    """
    pending = sorted(requests, key=lambda request: (-request.bid, request.frame_id))
    winners: list[Request] = []
    for request in pending:
        if len(winners) < slots and not walk(cluster, [*winners, request]).waiting:
            winners.append(request)
    return _conclude(state.last_frame_id, state, pending, winners)


def round_robin(
    state: ArbiterState, requests: Iterable[Request], *, cluster: Cluster, slots: int
) -> tuple[ArbiterState, tuple[Request, ...]]:
    """In turn by frame ID, from the one after the last that was served.

    Nobody is overtaken: the first request that does not fit ends the cycle. One that would not fit
    into an empty segment either is passed over, and waits for ever.
    """
    pending = sorted(
        requests, key=lambda request: (request.frame_id <= state.last_frame_id, request.frame_id)
    )
    winners: list[Request] = []
    for request in pending:
        if len(winners) == slots:
            break
        if not walk(cluster, [*winners, request]).waiting:
            winners.append(request)
        elif not walk(cluster, [request]).waiting:
            break
    last = winners[-1].frame_id if winners else state.last_frame_id
    return _conclude(last, state, pending, winners)


def starving(state: ArbiterState, cycles: int) -> tuple[tuple[int, int], ...]:
    """(node, cycles waited) of all who asked in vain in at least so many cycles in a row."""
    return tuple((node, waited) for node, waited in state.waits if waited >= cycles)


def always(bid: int) -> bool:
    """Ask in every cycle."""
    return True


def above(threshold: int) -> Trigger:
    """Ask only when the bid (the change since the last publication) is above the threshold."""
    return lambda bid: bid > threshold


def _conclude(
    last_frame_id: int, state: ArbiterState, pending: Sequence[Request], winners: Sequence[Request]
) -> tuple[ArbiterState, tuple[Request, ...]]:
    served = {request.node for request in winners}
    before = dict(state.waits)
    losers = sorted({request.node for request in pending} - served)
    waits = tuple((node, before.get(node, 0) + 1) for node in losers)
    ordered = tuple(sorted(winners, key=lambda request: request.frame_id))
    return ArbiterState(last_frame_id, waits), ordered
