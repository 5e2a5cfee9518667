"""Start-up and clock parameters, production clusters, and the levels a cluster keeps."""

import msgspec
import pytest

from concord.bus.flexray.clock_constraints import CLOCK_PARAMETERS
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.levels import broken_rules, precision_us
from concord.bus.flexray.presets import DEMO
from tests.bus.support import broken

PRODUCTION = Cluster(
    name="production",
    channels="AB",
    cycle_us=5000.0,
    macroticks_per_cycle=3636,
    macrotick_us=1.375,
    microticks_per_cycle=200000,
    static_slots=70,
    static_slot_macroticks=31,
    action_point_macroticks=2,
    static_payload_words=13,
    minislots=291,
    minislot_macroticks=5,
    minislot_action_point_macroticks=2,
    dynamic_slot_idle_phase_minislots=1,
    dynamic_payload_words=127,
    latest_transmission_minislot=249,
    symbol_window_macroticks=1,
    network_idle_time_macroticks=10,
    sync_slots=(1, 8, 24),
    startup_slots=(1, 24),
    sync_nodes_most=15,
    cold_start_attempts=8,
    listen_noise=2,
    passive_after_cycle_pairs=2,
    halt_after_cycle_pairs=2,
    drift_damping_microticks=2,
    offset_correction_start_macroticks=3632,
    offset_correction_microticks=127,
    rate_correction_microticks=81,
    drift_microticks=81,
    listen_timeout_microticks=400162,
    startup_range_microticks=212,
)
"""The cluster of vectorgrp/sil-kit's demos (ConfigBuilderTest, 70 slots of 31 macroticks), with a
payload that fits its slot, and key slots."""


@pytest.mark.parametrize(
    ("slots", "slot", "payload_words", "minislots", "minislot", "idle"),
    [(91, 24, 8, 289, 5, 7), (60, 43, 16, 210, 5, 6), (70, 31, 13, 291, 5, 11)],
)
def test_published_divisions_of_3636_macroticks_are_valid(
    slots: int, slot: int, payload_words: int, minislots: int, minislot: int, idle: int
):
    published = msgspec.structs.replace(
        PRODUCTION,
        static_slots=slots,
        static_slot_macroticks=slot,
        static_payload_words=payload_words,
        minislots=minislots,
        minislot_macroticks=minislot,
        latest_transmission_minislot=100,
        symbol_window_macroticks=0,
        network_idle_time_macroticks=3636 - slots * slot - minislots * minislot,
        offset_correction_start_macroticks=None,
    )
    assert published.network_idle_time_macroticks == idle
    assert broken_rules(published)["2.1"] == broken_rules(published)["3.0.1"] == ()


@pytest.mark.parametrize("field", CLOCK_PARAMETERS)
def test_each_stated_parameter_keeps_its_range_and_may_be_left_out(field: str):
    parameter = CLOCK_PARAMETERS[field]
    for outside in (parameter.low - 1, parameter.high + 1, float("nan"), "7", True):
        message = broken(DEMO, **{field: outside})
        assert field in message and parameter.standard_name in message
    assert msgspec.structs.replace(DEMO, **{field: None}) == DEMO


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"sync_slots": (1,)}, "sync_slots has 1; name 2 to 15 key slots"),
        ({"sync_slots": (1, 2, 3), "sync_nodes_most": 2}, "gSyncFrameIDCountMax = 2"),
        ({"sync_slots": (1, 2), "startup_slots": (1,)}, "startup_slots has 1; name the key"),
        ({"sync_slots": (1, 2), "startup_slots": ()}, "two cold-start nodes"),
        ({"sync_slots": (1, 2), "startup_slots": (1, 3)}, "startup_slots has 3, but sync_slots"),
        ({"sync_slots": (1, 71), "startup_slots": (1, 71)}, "static slots are 1 to 70"),
        ({"sync_slots": (1, 1), "startup_slots": (1, 1)}, "name each static slot"),
        ({"halt_after_cycle_pairs": 1}, "set halt_after_cycle_pairs to 2"),
        ({"drift_microticks": 602}, "allow 601; set drift_microticks to 601"),
        ({"rate_correction_microticks": 602}, "constraint 30 (pRateCorrectionOut"),
        ({"listen_timeout_microticks": 400000}, "2 x (200000 + 81) = 400162"),
        ({"offset_correction_us": 6.4}, "6.4 us need 257"),
        ({"offset_correction_start_macroticks": 3633}, "to 3632"),
        ({"offset_correction_start_macroticks": 3626}, "constraint 26"),
        ({"offset_correction_microticks": 400}, "set network_idle_time_macroticks to 13"),
    ],
)
def test_constraints_between_clock_parameters_are_refused_with_a_cure(fields, said):
    assert said in broken(PRODUCTION, **fields)


def test_propagation_delay_lengthens_the_static_slot():
    # (363 bits x 0.10015 us + delay) / (5000 / 3636 x 0.9985) macroticks and 2 x 2: 30.5 to 31.
    msgspec.structs.replace(PRODUCTION, propagation_delay_us=0.7)
    assert "needs 32" in broken(PRODUCTION, propagation_delay_us=0.8)


def test_levels_name_what_each_of_them_alone_demands():
    assert broken_rules(PRODUCTION)["2.1"] == broken_rules(PRODUCTION)["3.0.1"] == ()
    # Its window of one macrotick can hold no symbol: 2 x 2 + (9 + 30 + 11) bits.
    (window,) = broken_rules(PRODUCTION)["physical"]
    assert "constraint 16" in window and "a symbol needs 8" in window
    fewer = msgspec.structs.replace(DEMO, number_of_cycles=32)
    assert "always counts 64" in broken_rules(fewer)["2.1"][0]
    coarse = msgspec.structs.replace(
        DEMO,
        macroticks_per_cycle=5000,
        macrotick_us=2.0,
        static_slots=5,
        minislots=200,
        latest_transmission_minislot=0,
        network_idle_time_macroticks=5000 - 5 * 272 - 200 * 8,
        microtick_us=0.05,
        microticks_per_cycle=200000,
        drift_damping_microticks=11,
    )
    samples, damping = broken_rules(coarse)["3.0.1"]
    assert "pSamplesPerMicrotick is 1 or 2" in samples and "at most 10" in damping
    assert broken_rules(coarse)["2.1"] == ()


def test_the_physical_level_needs_slots_for_clocks_that_differ():
    # (34 + 20) x 0.025 us without a stated damping; CTU-IIG: damping 2 and 0.4 us make 2.65 us.
    assert precision_us(DEMO) == pytest.approx(1.35)
    apart = msgspec.structs.replace(DEMO, drift_damping_microticks=2, propagation_delay_us=0.4)
    assert precision_us(apart) == pytest.approx(2.65)
    assert broken_rules(apart)["physical"] == ()
    worse = msgspec.structs.replace(DEMO, precision_us=5.1)
    action_point, minislot_action_point, minislot = broken_rules(worse)["physical"]
    assert "is 6 macroticks; set 6" in action_point
    assert "gdMinislotActionPointOffset" in minislot_action_point
    assert "needs 9" in minislot
    short = msgspec.structs.replace(
        DEMO,
        macroticks_per_cycle=9843,
        cycle_us=9843.0,
        microticks_per_cycle=393720,
        network_idle_time_macroticks=3,
    )
    (idle,) = broken_rules(short)["physical"]
    assert "gdNIT" in idle and "needs 4" in idle
