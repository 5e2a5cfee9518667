"""Clusters to start from. Figures that no source gives are chosen here, and said to be chosen."""

from concord.bus.flexray.cluster import Cluster

AUDI = Cluster(
    name="audi",
    cycle_us=5000.0,
    macroticks_per_cycle=2778,
    macrotick_us=5000.0 / 2778,
    microticks_per_cycle=200000,
    static_slots=51,
    static_slot_macroticks=29,
    action_point_macroticks=2,
    static_payload_words=17,
    minislots=255,
    minislot_macroticks=5,
    minislot_action_point_macroticks=2,
    dynamic_payload_words=127,
    latest_transmission_minislot=225,
    network_idle_time_macroticks=24,
)
"""A production car, from a recording of eight cycles of its bus.

Seen: 51 static slots, 17 words, slots of 52.2 us (29 macroticks of 1.8 us) and minislots of 9.0 us
(5 macroticks). TSS has 9 bits; the first minislot is on the grid of the static slots. A cycle of
5 ms then has 2778 macroticks: 29/2778 of it are 52.196 us, and stations with one TSS length show
52.1965 us.
Chosen: the action points (2 is the largest that the slot length allows), 255 minislots, the longest
dynamic payload and pLatestTx that goes with it, no symbol window, the idle time that is left.
"""

FLEXRAY_ADAPTER = Cluster(
    name="flexray-adapter",
    cycle_us=5000.0,
    macroticks_per_cycle=5000,
    macrotick_us=1.0,
    microticks_per_cycle=200000,
    static_slots=60,
    static_slot_macroticks=65,
    action_point_macroticks=3,
    static_payload_words=8,
    minislots=163,
    minislot_macroticks=6,
    minislot_action_point_macroticks=3,
    dynamic_slot_idle_phase_minislots=1,
    dynamic_payload_words=8,
    latest_transmission_minislot=157,
    symbol_window_macroticks=19,
    network_idle_time_macroticks=103,
    transmission_start_bits=11,
)
"""The configuration of an open hardware adapter (nanamiwang/flexray_adapter).

Its static action point offset is 6, with which constraint 18 adds up to 5003 of 5000 macroticks;
chosen: 3, the same as in the minislots.
"""

BOSCH = Cluster(
    name="bosch",
    cycle_us=5000.0,
    macroticks_per_cycle=3361,
    macrotick_us=5000.0 / 3361,
    microticks_per_cycle=200000,
    static_slots=38,
    static_slot_macroticks=55,
    action_point_macroticks=2,
    static_payload_words=32,
    minislots=211,
    minislot_macroticks=6,
    minislot_action_point_macroticks=2,
    dynamic_payload_words=127,
    latest_transmission_minislot=181,
    network_idle_time_macroticks=5,
)
"""The cluster of Bosch's open network codec tests: 38 x 55 and 211 x 6 of 3361 macroticks in 5 ms.

Chosen: action points, the longest dynamic payload and its pLatestTx, TSS.
"""

DEMO = Cluster(
    name="demo",
    cycle_us=10000.0,
    macroticks_per_cycle=10000,
    macrotick_us=1.0,
    microticks_per_cycle=400000,
    static_slots=20,
    static_slot_macroticks=272,
    action_point_macroticks=3,
    static_payload_words=127,
    minislots=550,
    minislot_macroticks=8,
    minislot_action_point_macroticks=3,
    dynamic_payload_words=127,
    latest_transmission_minislot=516,
    network_idle_time_macroticks=160,
)
"""Made for sensor networks: 20 static slots and room for 16 dynamic frames, each of 254 bytes.

One frame carries a mean and covariance of six states in float64. A cycle lasts 10 ms.
"""

PRESETS = {cluster.name: cluster for cluster in (AUDI, FLEXRAY_ADAPTER, BOSCH, DEMO)}


def preset(name: str) -> Cluster:
    """The preset of this name. Raises ValueError that lists the names."""
    if name not in PRESETS:
        raise ValueError(f"no cluster preset {name!r}; there are {', '.join(sorted(PRESETS))}")
    return PRESETS[name]
