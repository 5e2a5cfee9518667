"""Clocks of a network in which some oscillators drift: precision, halting, passive nodes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.clocks import ClockDrift
from concord.bus.flexray.clocks import drifting
from concord.bus.flexray.clocks.drifting import clock_errors, slew_ppm, without_rest
from concord.bus.flexray.clocks.settings import clock_settings
from concord.bus.flexray.levels import precision_us
from concord.bus.flexray.presets import AUDI, DEMO, PRESETS


@settings(max_examples=20)
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
    drifts = (ClockDrift(nodes - 1, ppm, first),)
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
    drifts = (ClockDrift(node, ppm, first),)
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
    errors = [clock_errors(DEMO, 2, (ClockDrift(1, 9000.0, 0),), cycle) for cycle in range(1000)]
    silent = [next(k for k, one in enumerate(errors) if not one.sends[node]) for node in (0, 1)]
    deaf = [next(k for k, one in enumerate(errors) if not one.hears[node]) for node in (0, 1)]
    first, last = sorted((0, 1), key=lambda node: silent[node])
    assert silent[first] == deaf[first]
    assert silent[last] - silent[first] == 2 * known.passive_pairs
    assert deaf[last] - silent[first] == 2 * known.halt_pairs


def test_answers_do_not_depend_on_earlier_questions():
    drifts = (ClockDrift(1, -200.0, 3), ClockDrift(2, 700.0, 20))
    cycles = (2500, 7, 3, 40, 2, 41, 900)
    found = [clock_errors(AUDI, 4, drifts, cycle) for cycle in cycles]
    for cycle, one in zip(cycles, found, strict=True):
        drifting._drifting.cache_clear()
        assert clock_errors(AUDI, 4, drifts, cycle) == one


def test_key_slots_of_nodes_beyond_the_network_are_other_controllers():
    """A file may state more sync nodes than the network has nodes."""
    drifts = (ClockDrift(0, 9000.0, 0),)
    alone = [clock_errors(DEMO, 1, drifts, cycle) for cycle in (0, 900)]
    assert [one.sends[0] for one in alone] == [True, False]


@given(
    st.lists(
        st.builds(
            ClockDrift, st.integers(0, 3), st.sampled_from([-9000.0, 80.0, 3000.0]),
            st.integers(0, 10**6),
        ),
        min_size=1, max_size=4, unique_by=lambda one: one.node,
    ),
    st.integers(0, 10**6),
)  # fmt: skip
def test_cycles_in_which_nothing_changes_are_left_out(drifts: list[ClockDrift], cycle: int):
    slew = slew_ppm(clock_settings(DEMO, 4))
    moved, number = without_rest(tuple(drifts), cycle, slew)
    first = min(drift.first_cycle for drift in drifts)
    if cycle < first:
        assert number == cycle
    assert (number - cycle) % 2 == 0
    # The order of drifts and of the cycle stays, and a ramp keeps its whole length.
    for before, after in zip(sorted(drifts, key=lambda one: one.first_cycle), moved, strict=True):
        assert (after.first_cycle - before.first_cycle) % 2 == 0
        assert (cycle >= before.first_cycle) == (number >= after.first_cycle)
    last = max(drift.first_cycle for drift in moved)
    assert last - first <= len(drifts) * (9000 / slew + 403)
