"""Usual values of a cluster for elements that a thin export of FIBEX or AUTOSAR lacks."""

from typing import Any

from concord.bus.flexray.cluster import MICROTICKS_US, Cluster

ESSENTIAL = (
    "static_slots", "static_slot_macroticks", "static_payload_words", "minislots",
    "minislot_macroticks",
)  # fmt: skip
"""Fields without which a file describes no cluster; it also needs two of the three of a cycle."""
NAMED_USUAL = (
    "channels", "bit_rate_mbps", "cycle_us", "macrotick_us", "macroticks_per_cycle",
    "action_point_macroticks", "minislot_action_point_macroticks",
    "dynamic_slot_idle_phase_minislots", "transmission_start_bits", "symbol_window_macroticks",
    "network_idle_time_macroticks",
)  # fmt: skip
"""Fields that have a usual value."""
OF_CONTROLLERS = ("microtick_us", "dynamic_payload_words", "latest_transmission_minislot")
"""Fields of controllers that have a usual value."""
_PLAIN = {
    "channels": "A",
    "bit_rate_mbps": 10.0,
    "dynamic_slot_idle_phase_minislots": 0,
    "transmission_start_bits": 9,
    "symbol_window_macroticks": 0,
}


def usual_values(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that are None with their usual values.

    A macrotick lasts 1 us, unless cycle and macroticks of a cycle say otherwise. Action points are
    as late as static frames leave room for, and those of minislots before their end; the network
    idle time is the rest of a cycle.

    Raises:
        ClusterError: the other fields are of no cluster.
    """
    found = {name: value for name, value in _PLAIN.items() if fields[name] is None}
    cycle_us, macrotick_us = fields["cycle_us"], fields["macrotick_us"]
    macroticks = fields["macroticks_per_cycle"]
    if macrotick_us is None:
        macrotick_us = cycle_us / macroticks if cycle_us and macroticks else 1.0
    if macroticks is None:
        macroticks = round(cycle_us / macrotick_us)
    if cycle_us is None:
        cycle_us = macroticks * macrotick_us
    cycle = {
        "cycle_us": cycle_us, "macrotick_us": macrotick_us, "macroticks_per_cycle": macroticks
    }  # fmt: skip
    found |= {name: value for name, value in cycle.items() if fields[name] is None}
    slot, minislot = fields["static_slot_macroticks"], fields["minislot_macroticks"]
    if fields["action_point_macroticks"] is None:
        found["action_point_macroticks"] = _widest_action_point({**fields, **found}, slot)
    offset = fields["action_point_macroticks"] or found["action_point_macroticks"]
    if fields["minislot_action_point_macroticks"] is None:
        found["minislot_action_point_macroticks"] = max(1, min(offset, minislot - 2))
    if fields["network_idle_time_macroticks"] is None:
        minislot_offset = (
            fields["minislot_action_point_macroticks"] or found["minislot_action_point_macroticks"]
        )
        minislots = fields["minislots"]
        difference = max(0, offset - minislot_offset) if minislots else 0
        symbols = fields["symbol_window_macroticks"] or 0
        found["network_idle_time_macroticks"] = (
            macroticks - fields["static_slots"] * slot - difference - minislots * minislot - symbols
        )
    return found


def _widest_action_point(fields: dict[str, Any], slot: int) -> int:
    """Return the latest action point with which a static frame ends in its slot."""
    bare: dict[str, Any] = fields | {
        "action_point_macroticks": 1,
        "minislots": 0,
        "minislot_action_point_macroticks": 1,
        "symbol_window_macroticks": 0,
        "network_idle_time_macroticks": fields["macroticks_per_cycle"]
        - fields["static_slots"] * slot,
    }
    probe = with_usual_controllers({key: one for key, one in bare.items() if one is not None})
    room = slot - probe.static_frame_macroticks(probe.static_payload_bytes)
    return max(1, min(63, 1 + room // 2))


def with_usual_controllers(fields: dict[str, Any]) -> Cluster:
    """Return a cluster of these fields; those of the controllers are filled in where missing."""
    microtick_us = fields.get("microtick_us", 0.025)
    # Another microtick than FlexRay's is refused by the cluster, whatever is counted of it.
    known = microtick_us in MICROTICKS_US
    counts: dict[str, Any] = {
        "microticks_per_cycle": round(fields["cycle_us"] / microtick_us) if known else 0
    }
    silent = {"dynamic_payload_words": 0, "latest_transmission_minislot": 0}
    probe = Cluster(**{**counts, **fields, **silent})
    fitting = [n for n in range(128) if probe.dynamic_slot_most_minislots(2 * n) <= probe.minislots]
    words = fields.get("dynamic_payload_words", max(fitting, default=0))
    latest = max(0, probe.minislots - probe.dynamic_slot_most_minislots(2 * words) + 1)
    usual = {"dynamic_payload_words": words, "latest_transmission_minislot": latest}
    return Cluster(**{**counts, **usual, **fields})
