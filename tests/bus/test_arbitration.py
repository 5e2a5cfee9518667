"""Test arbiters: winners, fit of their frames, independence of order, and starvation."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, NO_BID, ArbiterState, award, begin_arbitration
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request, walk
from concord.bus.flexray.presets import DEMO, FLEXRAY_ADAPTER
from tests.bus.support import dynamic_segments, quick

ARBITER = pytest.mark.parametrize("arbiter", list(ARBITERS))
NODES = 100


class Asked(NamedTuple):
    """A request and how urgent it is."""

    request: Request
    bid: int


def asks(*bids: int, payload_bytes: int = 254) -> list[Asked]:
    """One request for each bid, on the demo cluster, by nodes 10, 11, ..."""
    return [
        Asked(Request(10 + place, 21 + place, payload_bytes), bid) for place, bid in enumerate(bids)
    ]


def with_bids(requests: Sequence[Request], bids: Sequence[int]) -> list[Asked]:
    return [Asked(request, bid) for request, bid in zip(requests, bids, strict=False)]


def serve_one(
    arbiter: str, state: ArbiterState, asked: Sequence[Asked], cluster: Cluster, slots: int
) -> tuple[ArbiterState, list[int]]:
    """The state after a cycle, and the winners in order of their slots."""
    requests = [one.request for one in asked]

    def fits(run: tuple[int, ...], places: Sequence[int]) -> bool:
        return not walk(cluster, [requests[place] for place in places]).waiting

    state, wins = award(
        ARBITERS[arbiter],
        state,
        [request.node for request in requests],
        np.array([request.frame_id for request in requests], dtype=np.int64),
        np.array([one.bid for one in asked], dtype=np.int64),
        slots,
        fits,
    )
    winners = [request for request, won in zip(requests, wins, strict=True) if won]
    return state, [winner.node for winner in sorted(winners, key=lambda one: one.frame_id)]


# --- the arbiters, request by request ------------------------------------------------------


def by_hand(
    arbiter: str, last: int, asked: Sequence[Asked], cluster: Cluster, slots: int
) -> tuple[int, list[int]]:
    """The frame ID served last, and the winners in order of their slots."""
    pending = [one.request for one in sorted(asked, key=lambda one: one.request.frame_id)]
    bids = {one.request.node: one.bid for one in asked}
    if arbiter in ("minislot", "urgency"):
        waiting = set(walk(cluster, pending).waiting)
        winners = [request for request in pending if request not in waiting][:slots]
    elif arbiter == "wtod":
        winners = []
        for request in sorted(pending, key=lambda request: -bids[request.node]):
            if len(winners) < slots and not walk(cluster, [*winners, request]).waiting:
                winners.append(request)
    else:
        winners = []
        turn = [request for request in pending if request.frame_id > last]
        for request in turn + [request for request in pending if request not in turn]:
            if len(winners) < slots and not walk(cluster, [*winners, request]).waiting:
                winners.append(request)
            elif not walk(cluster, [request]).waiting:
                break
        last = winners[-1].frame_id if winners else last
    return last, [request.node for request in sorted(winners, key=lambda one: one.frame_id)]


BIDS = st.lists(st.integers(0, 4), min_size=12, max_size=12)


@ARBITER
@quick
@given(
    segment=dynamic_segments(),
    bids=BIDS,
    last=st.integers(0, 80),
    slots=st.integers(0, 6),
    random=st.randoms(),
)
def test_winners_are_those_of_the_arbiter_by_hand(arbiter, segment, bids, last, slots, random):
    cluster, requests = segment
    asked = with_bids(requests, bids)
    state = begin_arbitration(NODES)._replace(last_frame_id=np.array(last))
    after, winners = serve_one(arbiter, state, asked, cluster, slots)
    last, expected = by_hand(arbiter, last, asked, cluster, slots)
    assert winners == expected
    if arbiter == "round-robin":
        assert after.last_frame_id == last
    random.shuffle(asked)
    again, same = serve_one(arbiter, state, asked, cluster, slots)
    assert same == winners
    np.testing.assert_array_equal(again.waits, after.waits)
    lost = {one.request.node for one in asked} - set(winners)
    assert set(np.flatnonzero(after.waits)) == lost


@ARBITER
@quick
@given(segment=dynamic_segments(), slots=st.integers(1, 6))
def test_the_bus_is_not_left_idle(arbiter: str, segment, slots):
    cluster, requests = segment
    asked = with_bids(requests, [0] * 12)
    _, winners = serve_one(arbiter, begin_arbitration(NODES), asked, cluster, slots)
    assert bool(winners) == any(not walk(cluster, [request]).waiting for request in requests)


@ARBITER
@quick
@given(
    bids=st.lists(st.lists(st.integers(NO_BID, 3), min_size=5, max_size=5), min_size=1, max_size=6),
    slots=st.integers(0, 5),
    cycles=st.integers(1, 4),
)
def test_many_runs_are_each_as_one(arbiter: str, bids: list[list[int]], slots: int, cycles: int):
    """A batch of runs, some slots for which all requests fit, and the same runs one by one."""
    nodes, ids = [1, 2, 4, 5, 6], np.arange(30, 35)
    together = begin_arbitration(8, (len(bids),))
    alone = [begin_arbitration(8) for _ in bids]
    for cycle in range(cycles):
        now = np.roll(np.array(bids), cycle, axis=1)
        together, wins = award(ARBITERS[arbiter], together, nodes, ids, now, slots)
        for run, own in enumerate(now):
            fits = lambda run, places: True  # noqa: E731
            alone[run], won = award(ARBITERS[arbiter], alone[run], nodes, ids, own, slots, fits)
            np.testing.assert_array_equal(wins[run], won)
            assert together.last_frame_id[run] == alone[run].last_frame_id
            np.testing.assert_array_equal(together.waits[run], alone[run].waits)


@ARBITER
def test_nobody_wins_where_nobody_asks(arbiter: str):
    state = ArbiterState(np.array(31), np.arange(8))
    nodes, ids = np.arange(3), np.arange(30, 33)
    for asked in (slice(0), slice(3)):
        bids = np.full(3, NO_BID)[asked]
        after, wins = award(ARBITERS[arbiter], state, nodes[asked], ids[asked], bids, 2)
        assert not wins.any()
        assert after.last_frame_id == 31
        np.testing.assert_array_equal(after.waits, state.waits)


def test_wtod_passes_over_what_does_not_fit_beside_larger_bids():
    # 16 frames of 34 minislots fill 544 of the demo's 550; after 15 of them and five silent slots
    # a short one may just begin, in minislot 516 = pLatestTx.
    asked = asks(*range(30, 13, -1))
    small = Asked(Request(99, 41, 0), 1)
    state = begin_arbitration(NODES)
    assert serve_one("wtod", state, [*asked, small], DEMO, 20)[1] == list(range(10, 26))
    assert serve_one("wtod", state, [*asked[:15], small], DEMO, 20)[1] == [*range(10, 25), 99]


def serve(arbiter: str, asked: list[Asked], cycles: int, slots: int) -> list[list[int]]:
    state, history = begin_arbitration(NODES), []
    for _ in range(cycles):
        state, winners = serve_one(arbiter, state, asked, DEMO, slots)
        history.append(winners)
    return history


def test_round_robin_serves_all_in_turn():
    assert serve("round-robin", asks(9, 0, 5, 5, 1), 5, 2) == [
        [10, 11],
        [12, 13],
        [10, 14],
        [11, 12],
        [13, 14],
    ]


@quick
@given(
    st.integers(1, 30), st.integers(1, 30), st.lists(st.integers(0, 254), min_size=30, max_size=30)
)
def test_round_robin_never_starves_whatever_the_lengths(count: int, slots: int, sizes: list[int]):
    asked = [Asked(Request(place, 21 + place, sizes[place] // 2 * 2), 0) for place in range(count)]
    # The first in turn always fits alone, so each node is served within as many cycles as nodes.
    served = serve("round-robin", asked, count, slots)
    assert {node for winners in served for node in winners} == set(range(count))


def test_round_robin_lets_nobody_overtake():
    """15 long frames after the pointer; slot 21 would push the last beyond pLatestTx, the short
    frame of slot 22 would not, but must not go before 21."""
    long = [Asked(Request(frame_id, frame_id, 254), 0) for frame_id in (21, *range(37, 52))]
    asked = [*long, Asked(Request(22, 22, 0), 0)]
    state = begin_arbitration(NODES)._replace(last_frame_id=np.array(36))
    state, winners = serve_one("round-robin", state, asked, DEMO, 99)
    assert winners == list(range(37, 52))
    state, winners = serve_one("round-robin", state, asked, DEMO, 99)
    assert winners[:2] == [21, 22]


def test_minislot_starves_high_ids_and_the_arbiter_knows():
    asked = asks(*[0] * 18)
    state = begin_arbitration(NODES)
    for cycle in range(7):
        state, winners = serve_one("minislot", state, asked, DEMO, 99)
        assert winners == list(range(10, 26))
        assert np.flatnonzero(state.waits).tolist() == [26, 27]
        assert state.waits[26] == cycle + 1
    # One quiet cycle of the low IDs and the waiting ones are served.
    state, winners = serve_one("minislot", state, asked[2:], DEMO, 99)
    assert winners == list(range(12, 28))
    assert not state.waits.any()


def test_a_frame_too_long_for_its_place_waits_for_ever_and_does_not_block():
    asked = [Asked(Request(0, 220, 16), 0), Asked(Request(1, 61, 16), 0)]
    state = begin_arbitration(NODES)._replace(last_frame_id=np.array(219))
    for _ in range(3):
        state, winners = serve_one("round-robin", state, asked, FLEXRAY_ADAPTER, 3)
        assert winners == [1]
    assert state.waits[0] == 3
