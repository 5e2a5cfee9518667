"""Clocks of a network in which oscillators drift or sync frames fail: precision, passive and halted
nodes."""

from itertools import pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from concord.bus.clocks import ClockDrift, SyncOutage
from concord.bus.flexray.clocks import disturbed
from concord.bus.flexray.clocks.disturbances import Disturbances
from concord.bus.flexray.clocks.disturbed import clock_errors, slew_ppm
from concord.bus.flexray.clocks.settings import clock_settings
from concord.bus.flexray.levels import precision_us
from concord.bus.flexray.presets import AUDI, DEMO, PRESETS
from concord.bus.flexray.publication import SyncNode


@settings(max_examples=5)
@given(
    name=st.sampled_from(sorted(PRESETS)),
    nodes=st.integers(3, 20),
    ppm=st.integers(-2900, 2900).filter(bool),
    first=st.integers(0, 40),
)
def test_clocks_stay_within_the_precision_while_one_drifts(
    name: str, nodes: int, ppm: int, first: int
):
    cluster = PRESETS[name]
    drifts = Disturbances((ClockDrift(nodes - 1, ppm, first),))
    for cycle in range(first + 500):
        errors = clock_errors(cluster, nodes, drifts, cycle)
        assert all(errors.sends) and all(errors.hears)
        apart_us = max(errors.ahead_us) - min(errors.ahead_us)
        assert apart_us <= precision_us(cluster)
        if cycle <= first:
            assert (apart_us > 0) == (cycle == first)


@pytest.mark.parametrize("first", [8, 9])
@pytest.mark.parametrize("ppm", [4000.0, -9000.0])
@pytest.mark.parametrize("node", [0, 17])
def test_a_node_halts_when_its_rate_passes_the_limit(node: int, ppm: float, first: int):
    known = clock_settings(AUDI, 20)
    drifts = Disturbances((ClockDrift(node, ppm, first),))
    errors = [clock_errors(AUDI, 20, drifts, cycle) for cycle in range(400)]
    halted = next(cycle for cycle, one in enumerate(errors) if not one.hears[node])
    borne_ppm = 1e6 * known.rate_limit / known.microticks
    # The correction follows the oscillator by a pair of cycles or two.
    assert 0 <= halted - first - borne_ppm / slew_ppm(known) <= 10
    for cycle, one in enumerate(errors):
        others = [sends for place, sends in enumerate(one.sends) if place != node]
        assert all(others) and one.sends[node] == one.hears[node] == (cycle < halted)


def test_the_last_sync_node_is_passive_and_then_halts():
    """Of two nodes neither can tell which of them drifts."""
    known = clock_settings(DEMO, 2)
    drifts = Disturbances((ClockDrift(1, 9000.0, 0),))
    errors = [clock_errors(DEMO, 2, drifts, cycle) for cycle in range(1000)]
    silent = [next(k for k, one in enumerate(errors) if not one.sends[node]) for node in (0, 1)]
    deaf = [next(k for k, one in enumerate(errors) if not one.hears[node]) for node in (0, 1)]
    first, last = sorted((0, 1), key=lambda node: silent[node])
    assert silent[first] == deaf[first]
    assert silent[last] - silent[first] == 2 * known.passive_pairs
    assert deaf[last] - silent[first] == 2 * known.halt_pairs


def test_answers_do_not_depend_on_earlier_questions():
    drifts = Disturbances((ClockDrift(1, -200.0, 3), ClockDrift(2, 700.0, 20)))
    cycles = (2500, 7, 3, 40, 2, 41, 900)
    found = [clock_errors(AUDI, 4, drifts, cycle) for cycle in cycles]
    for cycle, one in zip(cycles, found, strict=True):
        disturbed._disturbed.cache_clear()
        assert clock_errors(AUDI, 4, drifts, cycle) == one


def test_key_slots_of_nodes_beyond_the_network_are_other_controllers():
    """A file may state more sync nodes than the network has nodes."""
    drifts = Disturbances((ClockDrift(0, 9000.0, 0),))
    alone = [clock_errors(DEMO, 1, drifts, cycle) for cycle in (0, 900)]
    assert [one.sends[0] for one in alone] == [True, False]


TWO_SYNC_NODES = (SyncNode(0, 1, True), SyncNode(1, 2, True))


@pytest.mark.parametrize("first", [8, 9])
def test_nodes_without_sync_frames_are_passive_and_then_halt(first: int):
    """Each pair of cycles in which a frame is missing counts."""
    known = clock_settings(AUDI, 4)
    outages = (SyncOutage(0, first), SyncOutage(1, 17 - first))
    errors = [
        clock_errors(AUDI, 4, Disturbances(outages=outages), cycle, TWO_SYNC_NODES)
        for cycle in range(60)
    ]
    for cycle, one in enumerate(errors):
        assert one.ahead_us == (0.0,) * 4
        for node in (2, 3):
            assert one.sends[node] == (cycle < 8 + 2 * known.passive_pairs)
            assert one.hears[node] == (cycle < 8 + 2 * known.halt_pairs)


def test_one_sync_node_that_is_left_keeps_all_but_itself():
    known = clock_settings(AUDI, 4)
    silent = Disturbances(outages=(SyncOutage(0, 8),))
    errors = [clock_errors(AUDI, 4, silent, cycle, TWO_SYNC_NODES) for cycle in range(60)]
    passive, halted = 8 + 2 * known.passive_pairs, 8 + 2 * known.halt_pairs
    assert [one.sends[1] for one in errors] == [cycle < passive for cycle in range(60)]
    # It sends no sync frame once it is passive, so the others follow it.
    assert [one.hears[1] for one in errors] == [cycle < halted for cycle in range(60)]
    others = [one.hears[3] for one in errors]
    assert others == [cycle < passive + 2 * known.halt_pairs for cycle in range(60)]


@settings(max_examples=12)
@given(first=st.integers(0, 30), length=st.integers(1, 12))
def test_an_outage_that_is_short_stops_no_node(first: int, length: int):
    known = clock_settings(AUDI, 4)
    outages = (SyncOutage(0, first, first + length), SyncOutage(1, first, first + length))
    failed = sum(
        any(first <= cycle < first + length for cycle in (even, even + 1))
        for even in range(0, 60, 2)
    )
    sends = [
        clock_errors(AUDI, 4, Disturbances(outages=outages), cycle, TWO_SYNC_NODES).sends[2]
        for cycle in range(60)
    ]
    assert all(sends) == (failed < known.passive_pairs)


def test_a_clock_follows_the_sync_nodes_that_are_left():
    """Nodes 0 and 1 are fast. Without the sync frames of the others, node 4 has their rate."""
    drifts = (ClockDrift(0, 1000.0, 0), ClockDrift(1, 1000.0, 0))
    sync = tuple(SyncNode(node, node + 1, True) for node in range(4))
    outages = (SyncOutage(2, 100), SyncOutage(3, 100))

    def pace(disturbed: Disturbances, node: int) -> float:
        """Microseconds that a clock gains in a cycle, on average."""
        ahead = [clock_errors(AUDI, 5, disturbed, k, sync).ahead_us[node] for k in (300, 320)]
        return (ahead[1] - ahead[0]) / 20

    fast_us = 1000e-6 * AUDI.cycle_us
    assert pace(Disturbances(drifts), 4) < 0.6 * fast_us
    assert pace(Disturbances(drifts, outages), 4) == pytest.approx(fast_us, rel=0.1)


DRIFTS = st.lists(
    st.builds(
        ClockDrift, st.integers(0, 3), st.sampled_from([-9000.0, 80.0, 3000.0]),
        st.integers(0, 10**6),
    ),
    max_size=4, unique_by=lambda one: one.node,
)  # fmt: skip
OUTAGES = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 10**6), st.none() | st.integers(1, 10**5)).map(
        lambda one: SyncOutage(one[0], one[1], None if one[2] is None else one[1] + one[2])
    ),
    max_size=4,
)


@given(DRIFTS, OUTAGES, st.integers(0, 10**6))
def test_cycles_in_which_nothing_changes_are_left_out(
    drifts: list[ClockDrift], outages: list[SyncOutage], cycle: int
):
    assume(drifts or outages)
    slew = slew_ppm(clock_settings(DEMO, 4))
    before = Disturbances(tuple(drifts), tuple(outages))
    moved, number = before.without_rest(cycle, slew)
    if cycle < before.first_cycle:
        assert number == cycle
    assert (number - cycle) % 2 == 0
    # The order of all changes and of the cycle stays, and a ramp keeps its whole length.
    changes = list(zip(_changes(before), _changes(moved), strict=True))
    for was, now in changes:
        assert (was - now) % 2 == 0
        assert (cycle >= was) == (number >= now)
    assert all(a[1] <= b[1] for a, b in pairwise(sorted(changes)))
    last = max(now for _, now in changes)
    assert last - before.first_cycle <= len(changes) * (9000 / slew + 403)


@given(DRIFTS, OUTAGES, st.integers(0, 10**6), st.integers(-(10**7), 0))
def test_cycles_may_be_counted_from_later(
    drifts: list[ClockDrift], outages: list[SyncOutage], cycle: int, half: int
):
    """A bus that begins anew counts cycles from there, and earlier ones below zero."""
    assume(drifts or outages)
    slew, disturbed = slew_ppm(clock_settings(DEMO, 4)), Disturbances(tuple(drifts), tuple(outages))

    def earlier(at: int) -> int:
        return at + 2 * half

    moved, number = disturbed.without_rest(cycle, slew)
    expected = moved.renumbered(earlier), earlier(number)
    assert disturbed.renumbered(earlier).without_rest(earlier(cycle), slew) == expected


def _changes(disturbed: Disturbances) -> list[int]:
    """Cycles in which something begins or ends."""
    found = [one.first_cycle for one in disturbed.drifts]
    for outage in disturbed.outages:
        found += [outage.first_cycle, *([] if outage.end_cycle is None else [outage.end_cycle])]
    return found


@settings(max_examples=4)
@given(DRIFTS, OUTAGES, st.integers(0, 3000))
def test_cycles_that_are_left_out_change_no_state(
    drifts: list[ClockDrift], outages: list[SyncOutage], cycle: int
):
    assume(drifts or outages)
    near = Disturbances(
        tuple(one._replace(first_cycle=one.first_cycle % 3000) for one in drifts),
        tuple(
            SyncOutage(node, first % 3000, None if end is None else first % 3000 + end - first)
            for node, first, end in outages
        ),
    )
    whole = disturbed._DisturbedNodes(clock_settings(DEMO, 4), 4, near)
    found = clock_errors(DEMO, 4, near, cycle)
    told = whole.at(cycle)
    assert (found.sends, found.hears) == (told.sends, told.hears)
