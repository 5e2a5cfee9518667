"""Arbiters: who wins, that all of it fits, that order does not matter, and who starves."""

from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.arbitration import (
    Arbiter,
    ArbiterState,
    above,
    always,
    minislot,
    round_robin,
    starving,
    wtod,
)
from bus.dynamic_segment import Request, walk
from bus.presets import DEMO, FLEXRAY_ADAPTER
from tests.bus.support import dynamic_segments, quick

ARBITERS = pytest.mark.parametrize("arbiter", [minislot, wtod, round_robin])
states = st.builds(ArbiterState, last_frame_id=st.integers(0, 80), waits=st.just(()))


def asks(*bids: int, payload_bytes: int = 254) -> list[Request]:
    """One request for each bid, on the demo cluster, by nodes 10, 11, ..."""
    return [Request(10 + place, 21 + place, bid, payload_bytes) for place, bid in enumerate(bids)]


def nodes(requests: tuple[Request, ...]) -> list[int]:
    return [request.node for request in requests]


@ARBITERS
@quick
@given(segment=dynamic_segments(), state=states, slots=st.integers(0, 6), random=st.randoms())
def test_winners_fit_are_few_enough_and_do_not_depend_on_order(
    arbiter: Arbiter, segment, state, slots, random
):
    cluster, requests = segment
    after, winners = arbiter(state, requests, cluster=cluster, slots=slots)
    assert len(winners) <= slots
    assert set(winners) <= set(requests)
    assert list(winners) == sorted(winners, key=lambda request: request.frame_id)
    assert not walk(cluster, winners).waiting
    random.shuffle(requests)
    assert arbiter(state, requests, cluster=cluster, slots=slots) == (after, winners)
    lost = {request.node for request in requests} - set(nodes(winners))
    assert after.waits == tuple((node, 1) for node in sorted(lost))


@ARBITERS
@quick
@given(segment=dynamic_segments(), slots=st.integers(1, 6))
def test_the_bus_is_not_left_idle(arbiter: Arbiter, segment, slots):
    cluster, requests = segment
    _, winners = arbiter(ArbiterState(), requests, cluster=cluster, slots=slots)
    able = [request for request in requests if not walk(cluster, [request]).waiting]
    assert bool(winners) == bool(able)


@quick
@given(segment=dynamic_segments())
def test_minislot_winners_are_those_of_the_walk(segment):
    cluster, requests = segment
    _, winners = minislot(ArbiterState(), requests, cluster=cluster, slots=99)
    assert [w.frame_id for w in winners] == [p.frame_id for p in walk(cluster, requests).placed]


@quick
@given(st.lists(st.integers(0, 4), max_size=12), st.integers(0, 5))
def test_wtod_takes_the_largest_bids_and_of_equal_ones_the_lowest_id(bids: list[int], slots: int):
    requests = asks(*bids)
    _, winners = wtod(ArbiterState(), requests, cluster=DEMO, slots=slots)
    ranked = sorted(range(len(bids)), key=lambda place: (-bids[place], place))
    assert nodes(winners) == sorted(10 + place for place in ranked[:slots])


def test_wtod_passes_over_what_does_not_fit_beside_larger_bids():
    # 16 frames of 34 minislots fill 544 of the demo's 550; after 15 of them and six silent slots
    # a short one may just begin, in minislot 517 = pLatestTx.
    requests = asks(*range(30, 13, -1))
    small = Request(99, 42, 1, 0)
    _, winners = wtod(ArbiterState(), [*requests, small], cluster=DEMO, slots=20)
    assert nodes(winners) == list(range(10, 26))
    _, winners = wtod(ArbiterState(), [*requests[:15], small], cluster=DEMO, slots=20)
    assert nodes(winners) == [*range(10, 25), 99]


def serve(arbiter: Arbiter, requests: list[Request], cycles: int, slots: int) -> list[list[int]]:
    state, history = ArbiterState(), []
    for _ in range(cycles):
        state, winners = arbiter(state, requests, cluster=DEMO, slots=slots)
        history.append(nodes(winners))
    return history


def test_round_robin_serves_all_in_turn():
    assert serve(round_robin, asks(9, 0, 5, 5, 1), 5, 2) == [
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
    requests = [Request(place, 21 + place, 0, sizes[place] // 2 * 2) for place in range(count)]
    # The first in turn always fits alone, so everybody is served within as many cycles as nodes.
    served = serve(round_robin, requests, count, slots)
    assert {node for winners in served for node in winners} == set(range(count))


def test_round_robin_lets_nobody_overtake():
    """15 long frames after the pointer; slot 21 would push the last beyond pLatestTx, the short
    frame of slot 22 would not, but must not go before 21."""
    long = [Request(frame_id, frame_id, 0, 254) for frame_id in (21, *range(37, 52))]
    requests = [*long, Request(22, 22, 0, 0)]
    state = ArbiterState(last_frame_id=36)
    state, winners = round_robin(state, requests, cluster=DEMO, slots=99)
    assert nodes(winners) == list(range(37, 52))
    state, winners = round_robin(state, requests, cluster=DEMO, slots=99)
    assert nodes(winners)[:2] == [21, 22]


def test_minislot_starves_high_ids_and_says_so():
    requests = asks(*[0] * 18)
    state = ArbiterState()
    for _ in range(7):
        state, winners = minislot(state, requests, cluster=DEMO, slots=99)
        assert nodes(winners) == list(range(10, 26))
    assert starving(state, 7) == ((26, 7), (27, 7))
    assert starving(state, 8) == ()
    # One quiet cycle of the low IDs and the waiting ones are served.
    state, winners = minislot(state, requests[2:], cluster=DEMO, slots=99)
    assert nodes(winners) == list(range(12, 28))
    assert starving(state, 1) == ()


def test_a_frame_too_long_for_its_place_waits_for_ever_and_does_not_block():
    adapter = partial(round_robin, cluster=FLEXRAY_ADAPTER, slots=3)
    hopeless = Request(0, 220, 0, 16)
    state = ArbiterState(last_frame_id=219)
    for _ in range(3):
        state, winners = adapter(state, [hopeless, Request(1, 61, 0, 16)])
        assert nodes(winners) == [1]
    assert starving(state, 3) == ((0, 3),)


def test_triggers():
    assert always(0)
    assert not above(10)(10)
    assert above(10)(11)
