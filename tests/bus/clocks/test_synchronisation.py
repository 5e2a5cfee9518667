"""Fault-tolerant midpoint, offset and rate correction, damping, limits and halting."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.clocks.controller_states import (
    PASSIVE_TO_ACTIVE_PAIRS,
    PocState,
    after_pair,
    controllers,
)
from concord.bus.flexray.clocks.correction import (
    Corrections,
    CycleTiming,
    Deviations,
    corrections,
    measure,
    midpoint,
    periods,
)
from concord.bus.flexray.clocks.network import ClusterClocks, run_cycle, synchronised
from concord.bus.flexray.clocks.settings import TICK, ClockSettings, clock_settings
from concord.bus.flexray.presets import AUDI, DEMO, PRESETS
from concord.features.flexray_tools.clocks.clock_run import (
    Conditions,
    draw_conditions,
    run_clocks,
    spread_us,
)
from tests.bus.clocks.scalar_clocks import scalar_starts, sorted_and_dropped

ppm_of = st.integers(-1500, 1500)


def undelayed(known: ClockSettings, nodes: int) -> np.ndarray:
    return np.zeros((nodes, len(known.sync)), dtype=np.int64)


# --- the midpoint --------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.integers(-(10**6), 10**6), st.booleans()), min_size=1, max_size=15))
def test_the_midpoint_is_that_of_sorting_and_dropping(drawn: list[tuple[int, bool]]):
    values, known = (np.array(column) for column in zip(*drawn, strict=True))
    expected = sorted_and_dropped([value for value, is_known in drawn if is_known])
    assert midpoint(values, known) == expected
    # Further axes are lanes of their own.
    both = midpoint(np.array([values, -values]), np.array([known, known]))
    assert both.tolist() == [expected, -expected]


@pytest.mark.parametrize(
    ("values", "expected"),
    [([9], 9), ([0, 9], 4), ([0, -9], -4), ([-99, 1, 2, 99], 1), (list(range(7)), 3),
     ([-99, -99, 5, 6, 6, 7, 99, 99], 6)],
)  # fmt: skip
def test_the_midpoint_leaves_out_no_one_and_two_extremes(values: list[int], expected: int):
    assert midpoint(np.array(values), np.ones(len(values), dtype=bool)) == expected


# --- corrections ---------------------------------------------------------------------------------


@settings(max_examples=12)
@given(rates=st.lists(st.integers(-120, 120), min_size=2, max_size=9), damping=st.integers(0, 5))
def test_cycles_begin_when_a_scalar_model_says(rates: list[int], damping: int):
    """Rates within the window, as clocks that agree take a pair of cycles to correct them."""
    known = clock_settings(AUDI, len(rates))._replace(damping=damping)
    network = synchronised(known, periods(np.array(rates)))
    for cycle, expected in enumerate(scalar_starts(known, rates, 24)):
        nominal = cycle * known.microticks
        starts = [nominal + Fraction(int(one), TICK) for one in network.timing.start]
        assert starts == expected
        network, _ = run_cycle(known, network, undelayed(known, len(rates)))
    assert (network.controllers.state == PocState.ACTIVE).all()


@pytest.mark.parametrize("damping", [0, 1, 3])
def test_damping_draws_rates_towards_zero_and_not_across(damping: int):
    known = clock_settings(AUDI, 3)._replace(damping=damping)
    network = synchronised(known, periods(np.zeros(3)))
    rate = np.array([10, 10, 10])
    network = network._replace(timing=network.timing._replace(rate=rate))
    for pair in range(12):
        expected = max(0, 10 - pair * damping)
        assert network.timing.rate.tolist() == [expected] * 3
        for _ in range(2):
            network, _ = run_cycle(known, network, undelayed(known, 3))


def sound(changes: list[int], offsets: list[int]) -> tuple[Deviations, Deviations]:
    """Measurements of one node that sends nothing."""
    odd = np.array([offsets])
    heard = np.ones_like(odd, dtype=bool)
    return Deviations(odd - np.array([changes]), heard), Deviations(odd, heard)


def of_three(**limits: int) -> ClockSettings:
    """Settings in which nodes 1, 2 and 3 send, and node 0 does not."""
    known = clock_settings(AUDI, 3)
    sync = tuple(one._replace(node=one.node + 1) for one in known.sync)
    return known._replace(sync=sync, damping=0, **limits)


@pytest.mark.parametrize("change", [-21, -20, 20, 21])
def test_a_rate_beyond_its_limit_is_exceeded_and_clipped(change: int):
    known = of_three(rate_limit=50)
    before = np.array([int(30 * np.sign(change))])
    done = corrections(known, before, *sound([change] * 3, [0] * 3))
    assert done.exceeded.tolist() == [abs(change) > 20]
    assert done.rate.tolist() == [50 * np.sign(change)]


@pytest.mark.parametrize("offset", [-41, -40, 40, 41])
def test_an_offset_beyond_its_limit_is_exceeded_and_clipped(offset: int):
    known = of_three(offset_limit=40)
    done = corrections(known, np.array([0]), *sound([0] * 3, [offset] * 3))
    assert done.exceeded.tolist() == [abs(offset) > 40]
    assert done.offset.tolist() == [40 * np.sign(offset)]


def test_a_frame_counts_up_to_the_action_point_offset_and_the_own_one_as_zero():
    known = clock_settings(AUDI, 3)
    none = np.zeros(3, dtype=np.int64)
    timing = CycleTiming(none, none, periods(np.zeros(3)))
    # Node 1 is as late as a node may be, node 2 a microtick later; each hears itself at once.
    delays = np.array([0, known.window, known.window + 1]) * TICK
    found = measure(known, timing, np.tile(delays, (3, 1)), np.ones(3, dtype=bool))
    assert found.deviation[0].tolist() == [0, known.window, known.window + 1]
    assert found.known.tolist() == [[True, True, False], [True, True, False], [True, True, True]]
    assert found.deviation[1, 1] == found.deviation[2, 2] == 0
    assert known.window == int(AUDI.action_point_us / 0.025)


def test_without_frames_of_others_the_correction_is_missing_and_the_rate_stays():
    known = clock_settings(AUDI, 3)
    network = synchronised(known, periods(np.zeros(3)))
    # Nodes 1 and 2 are halted, so node 0 hears its own frame alone.
    alone = np.array([PocState.ACTIVE, PocState.HALT, PocState.HALT])
    network = network._replace(
        timing=network.timing._replace(rate=np.array([7, 7, 7])),
        controllers=network.controllers._replace(state=alone),
    )
    states = []
    for _ in range(known.halt_pairs + 1):
        states.append(network.controllers.state[0])
        network, _ = run_cycle(known, network, undelayed(known, 3))
        network, passed = run_cycle(known, network, undelayed(known, 3))
        assert passed.corrections is not None and passed.corrections.missing[0]
        assert network.timing.rate[0] == 7
    passive, halt = known.passive_pairs, known.halt_pairs
    assert 1 < passive < halt
    expected = [PocState.ACTIVE] * passive + [PocState.PASSIVE] * (halt - passive) + [PocState.HALT]
    assert states == expected


# --- states --------------------------------------------------------------------------------------


def after(known: ClockSettings, pairs: str) -> list[PocState]:
    """States of one node after pairs: "." sound, "m" missing, "x" exceeded."""
    node, found = controllers(1, PocState.ACTIVE), []
    none = np.zeros(1, dtype=np.int64)
    for pair in pairs:
        missing, exceeded = np.array([pair == "m"]), np.array([pair == "x"])
        node = after_pair(known, node, Corrections(none, none, exceeded, missing))
        found.append(PocState(node.state[0]))
    return found


def test_pairs_without_correction_make_a_node_passive_and_then_halt_it():
    known = clock_settings(AUDI, 3)._replace(passive_pairs=2, halt_pairs=5)
    a, p, h = PocState.ACTIVE, PocState.PASSIVE, PocState.HALT
    assert PASSIVE_TO_ACTIVE_PAIRS == 2
    assert after(known, "m.m.") == [a] * 4
    assert after(known, "mmmmm.") == [a, p, p, p, h, h]
    assert after(known, "mm..m") == [a, p, p, a, a]
    assert after(known, "mm.m..") == [a, p, p, p, p, a]
    assert after(known, ".x.") == [a, h, h]
    assert after(known, "mmx") == [a, p, h]
    # Fatal before passive: a node halts at once.
    assert after(known._replace(passive_pairs=3, halt_pairs=3), "mmm") == [a, a, h]


def test_a_passive_node_sends_no_frame_and_still_follows_the_others():
    known = clock_settings(AUDI, 4)
    network = synchronised(known, periods(np.array([0, 0, 0, 100])))
    passive = np.array([PocState.ACTIVE] * 3 + [PocState.PASSIVE])
    network = network._replace(controllers=network.controllers._replace(state=passive))
    _, passed = run_cycle(known, network, undelayed(known, 4))
    assert passed.measured.known.tolist() == [[True, True, True, False]] * 4
    for _ in range(60):
        network, _ = run_cycle(known, network, undelayed(known, 4))
    assert (network.controllers.state == PocState.ACTIVE).all()
    assert network.timing.rate[3] > 10


# --- precision -----------------------------------------------------------------------------------


def worst_case_us(damping: int, delay_us: float) -> float:
    """(34 + 20 pClusterDriftDamping) microticks of 25 ns, and the delay there and back."""
    return (34 + 20 * damping) * 0.025 + 2 * delay_us


@settings(max_examples=12)
@given(
    name=st.sampled_from(sorted(PRESETS)),
    rates=st.lists(ppm_of, min_size=2, max_size=20),
    damping=st.integers(0, 2),
    delay_us=st.sampled_from([0.0, 0.25, 0.5]),
    seed=st.integers(0, 2**32 - 1),
)
def test_precision_stays_within_the_worst_case_of_the_specification(
    name: str, rates: list[int], damping: int, delay_us: float, seed: int
):
    bound = worst_case_us(damping, delay_us)
    known = clock_settings(PRESETS[name], len(rates))._replace(
        damping=damping, delay_us=delay_us, precision_us=bound
    )
    conditions = draw_conditions(len(rates), np.array(rates, dtype=float), 1.0, seed)
    run = run_clocks(known, conditions, 300, seed)
    assert run.spreads_us[-1] > 0 or len(set(rates)) == 1
    assert run.precision_us <= bound
    assert (run.network.controllers.state == PocState.ACTIVE).all()


@settings(max_examples=12)
@given(
    nodes=st.integers(4, 10),
    liar=st.integers(0, 3),
    reach=st.integers(1, 119),
    seed=st.integers(0, 2**32 - 1),
)
def test_one_two_faced_sync_node_does_not_break_precision(
    nodes: int, liar: int, reach: int, seed: int
):
    """The liar is early at some nodes and late at others, the more so in odd cycles."""
    known = clock_settings(DEMO, nodes)
    generator = np.random.default_rng(seed)
    network: ClusterClocks = synchronised(known, periods(generator.uniform(-20, 20, nodes)))
    honest = np.arange(nodes) != liar
    for cycle in range(300):
        delays = undelayed(known, nodes)
        sides = generator.choice((-1, 1), nodes)
        delays[:, liar] = sides * reach * TICK * (1 + cycle % 2) // 2
        assert spread_us(known, network, honest) <= worst_case_us(known.damping, 0.0)
        network, _ = run_cycle(known, network, delays)
    assert (network.controllers.state[honest] == PocState.ACTIVE).all()


def test_two_liars_among_five_sync_nodes_do_break_it():
    """The midpoint of five leaves out one extreme on either side, so the bound is no tautology."""
    known = clock_settings(DEMO, 5)
    run = run_clocks(known, draw_conditions(5, 1500.0, 1.0, 1, liars=2), 1000, 1)
    assert run.precision_us > known.precision_us


def test_without_correction_clocks_part():
    known = clock_settings(DEMO, 3)
    network = synchronised(known, periods(np.array([0.0, 0.0, 100.0])))
    halted = np.array([PocState.HALT] * 3)
    network = network._replace(controllers=network.controllers._replace(state=halted))
    for _ in range(10):
        network, _ = run_cycle(known, network, undelayed(known, 3))
    apart_us = float(np.ptp(network.timing.start)) / TICK * known.microtick_us
    assert apart_us == pytest.approx(10 * DEMO.cycle_us * 100e-6)


@pytest.mark.slow
def test_twenty_nodes_at_1500_ppm_keep_the_precision_over_thirty_thousand_cycles():
    known = clock_settings(AUDI, 20)
    rates = np.tile([1500.0, -1500.0], 10)
    none = np.zeros(20)
    conditions = Conditions(rates, np.linspace(0, 1, 20), none)
    run = run_clocks(known, conditions, 30_000, 1)
    assert 0.1 < run.precision_us <= known.precision_us
    assert (run.network.controllers.state == PocState.ACTIVE).all()


def test_midpoints_of_several_clocks_are_those_of_each():
    generator = np.random.default_rng(8)
    values = generator.integers(-50, 50, (5, 9))
    known = generator.random((5, 9)) < 0.7
    known[2] = False
    each = [midpoint(one, mask) for one, mask in zip(values, known, strict=True)]
    np.testing.assert_array_equal(midpoint(values, known), each)
