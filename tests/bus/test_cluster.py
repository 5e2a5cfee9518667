"""Clusters: the published ones add up, and every broken rule is refused by name."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.cluster import PARAMETERS, Cluster
from concord.bus.flexray.presets import AUDI, BOSCH, DEMO, FLEXRAY_ADAPTER, PRESETS, preset
from tests.bus.support import broken, clusters, quick


def test_audi_has_the_grid_of_the_recording():
    assert (AUDI.static_slots, AUDI.static_payload_bytes) == (51, 34)
    assert AUDI.static_slot_us == pytest.approx(52.2, abs=0.005)
    assert AUDI.minislot_us == pytest.approx(9.0, abs=0.001)
    assert AUDI.macrotick_us == pytest.approx(1.8, abs=0.0002)
    assert AUDI.cycle_time_s == pytest.approx(5e-3)


def test_published_clusters_have_their_published_figures():
    adapter, bosch = FLEXRAY_ADAPTER, BOSCH
    assert (adapter.static_slots, adapter.static_slot_macroticks) == (60, 65)
    assert (adapter.minislots, adapter.minislot_macroticks) == (163, 6)
    assert (adapter.symbol_window_macroticks, adapter.network_idle_time_macroticks) == (19, 103)
    assert (adapter.latest_transmission_minislot, adapter.microticks_per_cycle) == (157, 200000)
    assert (bosch.static_slots, bosch.static_slot_macroticks) == (38, 55)
    assert (bosch.minislots, bosch.minislot_macroticks) == (211, 6)
    assert (bosch.macroticks_per_cycle, bosch.cycle_us) == (3361, 5000.0)


def test_published_latest_transmission_follows_from_the_dynamic_slot_length():
    # A real configuration says 157 for 8 words in 163 minislots; nothing of it is fitted to that.
    assert FLEXRAY_ADAPTER.latest_start_minislot == 157


def test_demo_holds_six_states_in_float64_for_twenty_nodes():
    state_and_triangle_bytes = 8 * (6 + 6 * 7 // 2)
    for payload in (DEMO.static_payload_bytes, DEMO.dynamic_payload_bytes):
        assert payload >= state_and_triangle_bytes + 16
    assert DEMO.static_slots >= 20
    assert DEMO.number_of_cycles == 64


def test_presets_are_found_by_name_and_a_typo_lists_them():
    assert all(preset(name).name == name for name in PRESETS)
    with pytest.raises(ValueError, match="audi, bosch, demo, flexray-adapter"):
        preset("bmw")


def test_frame_length_of_the_recorded_static_frames():
    # 9 bits TSS, FSS, ten bits for each of 5 + 34 + 3 bytes, FES: 43.2 us at 10 Mbit/s.
    assert AUDI.frame_bits(34) == 432
    assert AUDI.frame_us(34) == pytest.approx(43.2)


def test_ranges_are_those_of_the_specification():
    """FlexRay 3.0.1, appendix B, as the validators of open projects cite it."""
    ranges = {parameter.standard_name: parameter[1:] for parameter in PARAMETERS.values()}
    assert {
        "gMacroPerCycle": (8, 16000),
        "gdMacrotick": (1, 6),
        "gNumberOfStaticSlots": (2, 1023),
        "gdStaticSlot": (3, 664),
        "gdActionPointOffset": (1, 63),
        "gPayloadLengthStatic": (0, 127),
        "gNumberOfMinislots": (0, 7988),
        "gdMinislot": (2, 63),
        "gdMinislotActionPointOffset": (1, 31),
        "gdDynamicSlotIdlePhase": (0, 2),
        "pLatestTx": (0, 7988),
        "gdSymbolWindow": (0, 162),
        "gdTSSTransmitter": (1, 15),
        "gdNIT": (2, 15978),
        "gCycleCountMax + 1": (8, 64),
    }.items() <= ranges.items()


@pytest.mark.parametrize("field", PARAMETERS)
def test_each_range_is_kept_at_both_ends(field: str):
    parameter = PARAMETERS[field]
    for outside in (parameter.low - 1, parameter.high + 1):
        message = broken(DEMO, **{field: outside})
        assert field in message
        assert parameter.standard_name in message
        assert f"is {outside}" in message
        assert f"{parameter.low} to {parameter.high}" in message
    for nonsense in (float("nan"), "7", None, True):
        assert field in broken(DEMO, **{field: nonsense})


def test_odd_number_of_cycles_is_refused():
    assert "set 64" in broken(DEMO, number_of_cycles=63)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("channels", "C"),
        ("bit_rate_mbps", 8.0),
        ("microtick_us", 0.1),
        ("name", ""),
        ("name", " a"),
        ("name", "a\nb"),
    ],
)
def test_choices_are_named(field: str, value: object):
    message = broken(DEMO, **{field: value})
    assert field in message
    assert repr(value) in message


def test_constraint_17_names_both_sides_and_the_cure():
    message = broken(DEMO, macrotick_us=1.01)
    assert "constraint 17" in message
    assert "10000" in message
    assert "10100" in message
    cured = msgspec.structs.replace(DEMO, macrotick_us=10000 / 10000)
    assert cured == DEMO


def test_constraint_17_accepts_a_macrotick_that_is_right_in_its_printed_digits():
    for printed in (1.488, 1.4877, 1.48765, 1.487652484):
        assert msgspec.structs.replace(BOSCH, macrotick_us=printed) == BOSCH
    for misprinted in (1.49, 1.487, 1.4879, 1.48768, 1.487654):
        assert "constraint 17" in broken(BOSCH, macrotick_us=misprinted)
    # A whole number is no excuse: 1.001 us are not printed as 1.
    assert "constraint 17" in broken(DEMO, cycle_us=10010.0, microticks_per_cycle=400400)


def test_constraint_18_names_both_sides_and_its_cure_works():
    message = broken(DEMO, network_idle_time_macroticks=150)
    assert "constraint 18" in message
    assert "is 10000" in message
    assert "272 x 20 + 0 + 8 x 550 + 0 + 150 = 9990" in message
    assert "set network_idle_time_macroticks to 160" in message
    msgspec.structs.replace(DEMO, network_idle_time_macroticks=160)


def test_constraint_18_counts_the_action_point_difference():
    message = broken(DEMO, minislot_action_point_macroticks=1)
    assert "272 x 20 + 2 + 8 x 550" in message


def test_constraint_19_names_both_sides_and_the_cure():
    message = broken(DEMO, microticks_per_cycle=399999)
    assert "constraint 19" in message
    assert "is 399999" in message
    assert "= 400000" in message


def test_static_slot_too_short_for_its_frame_is_refused():
    # 2 x 3 + (9 + 1 + 10 x 262 + 2 + 11) x 0.10015 us in macroticks of 0.9985 us: 265.1, so 272.
    message = broken(DEMO, static_slot_macroticks=271, network_idle_time_macroticks=180)
    assert "constraint 12" in message and "needs 272 macroticks" in message
    msgspec.structs.replace(
        DEMO,
        static_payload_words=126,
        static_slot_macroticks=270,
        network_idle_time_macroticks=200,
    )


def test_latest_transmission_that_lets_a_frame_overrun_the_segment_is_refused():
    message = broken(DEMO, latest_transmission_minislot=517)
    # (2632 + 1) x 0.10015 us in minislots of 7.988 us: 33.01, so 34, and one more of 550.
    assert "constraint 15" in message and "pLatestTx" in message
    assert "lasts 35 of 550" in message and "to 516" in message


def test_several_broken_rules_are_all_reported():
    message = broken(DEMO, network_idle_time_macroticks=150, microticks_per_cycle=1000)
    assert "constraint 18" in message
    assert "constraint 19" in message


def test_a_slot_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match=r"no static slot 21.*1\.\.20"):
        DEMO.slot_start_us(21)


@quick
@given(clusters())
def test_segments_of_a_random_cluster_fill_its_cycle(cluster: Cluster):
    end_of_static = cluster.slot_start_us(cluster.static_slots) + cluster.static_slot_us
    end_of_dynamic = cluster.minislot_start_us(cluster.minislots + 1)
    rest = cluster.symbol_window_macroticks + cluster.network_idle_time_macroticks
    assert cluster.dynamic_segment_start_us >= end_of_static - 1e-9
    assert end_of_dynamic + rest * cluster.macrotick_us == pytest.approx(cluster.cycle_us)


def test_microticks_belong_to_the_bit_rate():
    """Samples of gdBit / 8: a microtick has 1, 2 or 4 of them."""
    message = broken(DEMO, bit_rate_mbps=5.0, microtick_us=0.0125, microticks_per_cycle=800000)
    assert "0.5 samples at 5 Mbit/s; set microtick_us to 0.025 or 0.05" in message
    assert "to 0.05" in broken(DEMO, bit_rate_mbps=2.5)


def test_constraint_6_bounds_microticks_per_macrotick():
    short = broken(DEMO, microtick_us=0.05, microticks_per_cycle=200000)
    assert "constraint 6" in short and "between 2 and 12" in short
    long = broken(
        DEMO,
        cycle_us=16000.0,
        macroticks_per_cycle=4000,
        microtick_us=0.0125,
        microticks_per_cycle=1280000,
    )
    assert "constraint 6" in long and "between 0.5 and 3" in long


@quick
@given(clusters(), st.integers(0, 127))
def test_a_static_frame_that_fits_leaves_its_slot_in_time(cluster: Cluster, words: int):
    """Even where the sender's bits are 1500 ppm long, and the receiver's macroticks as short."""
    fast_us = 0.9985 * cluster.macrotick_us
    frame_us = (cluster.frame_bits(2 * words) + 11) * 1.0015 * cluster.bit_us
    room_us = (cluster.static_slot_macroticks - 2 * cluster.action_point_macroticks) * fast_us
    need = cluster.static_frame_macroticks(2 * words)
    assert (need <= cluster.static_slot_macroticks) == (frame_us <= room_us + 1e-9)


@quick
@given(clusters(min_minislots=1), st.integers(0, 127))
def test_a_dynamic_slot_holds_the_frame_a_trailing_bit_and_one_minislot(
    cluster: Cluster, words: int
):
    """As a receiver counts: minislots begin until the trailing sequence has ended."""
    bits = cluster.frame_bits(2 * words) + 1
    begun = 1
    while begun * cluster.minislot_us < bits * cluster.bit_us - 1e-9:
        begun += 1
    idle_phase = cluster.dynamic_slot_idle_phase_minislots
    assert cluster.dynamic_slot_minislots(2 * words) == begun + 1 + idle_phase
    most = cluster.dynamic_slot_most_minislots(2 * words)
    assert begun + 1 + idle_phase <= most <= begun + 2 + idle_phase
