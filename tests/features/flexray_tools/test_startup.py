"""Cold start: roles, cycles until normal active, collisions, attempts, late nodes."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.clocks.controller_states import PocState
from concord.bus.flexray.clocks.correction import periods
from concord.bus.flexray.clocks.settings import TICK, ClockSettings, clock_settings
from concord.bus.flexray.presets import AUDI, PRESETS
from concord.features.flexray_tools.clocks.startup import ColdStart


def started(
    known: ClockSettings, ppm: list[float], power_on: list[float], most: int = 200
) -> ColdStart:
    """Run a cold start whose nodes are switched on at these times, in cycles."""
    on = np.rint(np.array(power_on) * known.microticks * TICK).astype(np.int64)
    start = ColdStart(known, periods(np.array(ppm)), on)
    delays = np.zeros((len(ppm), len(known.sync)), dtype=np.int64)
    while not start.is_over and start.cycles < most:
        start.step(delays)
    return start


@settings(max_examples=40)
@given(
    name=st.sampled_from(sorted(PRESETS)),
    ppm=st.lists(st.integers(-1500, 1500), min_size=4, max_size=12),
    first=st.sampled_from([0, 1, 2]),
    others=st.floats(0.1, 1.5),
)
def test_a_cold_start_takes_the_cycles_of_the_standard(
    name: str, ppm: list[int], first: int, others: float
):
    """FlexRay 2.1, 7.2.3: cycle 6 for the leading, 7 for a following and 8 for another node."""
    nodes = len(ppm)
    power_on = [others] * nodes
    power_on[first] = 0.0
    start = started(clock_settings(PRESETS[name], nodes), [float(one) for one in ppm], power_on)
    expected = [7, 7, 7] + [8] * (nodes - 3)
    expected[first] = 6
    assert start.active_from.tolist() == expected
    assert (start.leader, start.attempts) == (first, 1)


def test_states_follow_one_another_as_in_the_standard():
    known = clock_settings(AUDI, 4)
    on = np.array([0, 1, 1, 1]) * known.microticks * TICK
    start = ColdStart(known, periods(np.zeros(4)), on)
    delays = np.zeros((4, len(known.sync)), dtype=np.int64)
    seen: list[list[str]] = [[], [], [], []]
    for _ in range(9):
        for states, state in zip(seen, start.network.controllers.state.tolist(), strict=True):
            states.append(PocState(state).name)
        start.step(delays)
    leading = ["COLLISION_RESOLUTION"] * 4 + ["CONSISTENCY_CHECK"] * 2 + ["ACTIVE"] * 3
    following = ["LISTEN", "INITIALIZE_SCHEDULE", *["COLDSTART_CHECK"] * 2, *["JOIN"] * 3]
    other = ["LISTEN", "INITIALIZE_SCHEDULE", *["INTEGRATION_CHECK"] * 6, "ACTIVE"]
    assert seen == [leading, following + ["ACTIVE"] * 2, following + ["ACTIVE"] * 2, other]


def test_of_nodes_that_begin_at_once_the_lowest_key_slot_leads_after_a_gap():
    """The others miss its first frames, so that no frame answers in cycle 4: one attempt more."""
    start = started(clock_settings(AUDI, 4), [0.0] * 4, [0.0] * 4)
    assert start.collided == (0, 1, 2)
    assert (start.leader, start.attempts) == (0, 2)
    assert start.active_from.tolist() == [12, 13, 13, 14]


def test_two_of_three_that_collide_lose_no_attempt_where_the_third_hears_all():
    start = started(clock_settings(AUDI, 4), [0.0] * 4, [0.0, 0.0, 0.5, 0.5])
    assert start.collided == (0, 1)
    assert start.active_from[[0, 2]].tolist() == [6, 7]


@pytest.mark.parametrize("late", [4, 5, 9.5, 20])
def test_a_late_node_integrates_with_the_next_even_cycle(late: float):
    """Two cycles to set its schedule and two pairs of checks; one that joins takes one more."""
    known = clock_settings(AUDI, 5)
    listen = known.listen / known.microticks
    start = started(known, [0.0] * 5, [0, 0.5, late + listen, late + listen, 0.5])
    even = int(np.ceil(late / 2)) * 2
    assert start.active_from.tolist() == [6, 7, even + 7, even + 6, 8]


def test_without_an_answer_the_leading_node_uses_its_attempts_and_another_one_leads():
    cluster = msgspec.structs.replace(
        AUDI, sync_slots=(1, 2), startup_slots=(1, 2), cold_start_attempts=3
    )
    known = clock_settings(cluster, 3)
    # Node 1 hears nothing before the attempts of node 0 are over.
    start = started(known, [0.0] * 3, [0.0, 100.0, 0.0])
    assert start.attempts > 3
    assert start.has_failed and (start.active_from < 0).all()
    # Three nodes that start bear one that is away.
    known = clock_settings(AUDI, 3)._replace(attempts=3)
    start = started(known, [5000.0, 0.0, 0.0], [0.0, 0.5, 1.0])
    # Three attempts of six cycles, the listen timeout, and a start.
    silence = int(np.ceil(known.listen / known.microticks))
    assert start.leader in (1, 2)
    assert start.active_from[start.leader] >= 3 * 6 + silence + 6
    assert start.refused.tolist() == [True, False, False]


def test_a_cluster_needs_two_nodes_that_start_it():
    known = clock_settings(AUDI, 3)
    lonely = known._replace(sync=known.sync[:1])
    with pytest.raises(ValueError, match="a cold start takes two"):
        ColdStart(lonely, periods(np.zeros(3)), np.zeros(3, dtype=np.int64))


def test_settings_are_those_of_the_cluster_and_refuse_too_few_nodes():
    stated = msgspec.structs.replace(
        AUDI,
        sync_slots=(8, 24, 45),
        startup_slots=(8, 45),
        drift_damping_microticks=2,
        rate_correction_microticks=300,
        offset_correction_microticks=99,
        passive_after_cycle_pairs=3,
        halt_after_cycle_pairs=7,
        cold_start_attempts=4,
        precision_us=2.0,
    )
    known = clock_settings(stated, 5)
    assert [(one.key_slot, one.starts) for one in known.sync] == [
        (8, True),
        (24, False),
        (45, True),
    ]
    assert known.action_points.tolist() == [7 * 29 + 2, 23 * 29 + 2, 44 * 29 + 2]
    assert (known.damping, known.rate_limit, known.offset_limit) == (2, 300, 99)
    assert (known.passive_pairs, known.halt_pairs, known.attempts) == (3, 7, 4)
    assert known.precision_us == 2.0
    with pytest.raises(ValueError, match="use at least 3 nodes"):
        clock_settings(stated, 2)
    with pytest.raises(ValueError, match="use at least 2 nodes"):
        clock_settings(AUDI, 1)
