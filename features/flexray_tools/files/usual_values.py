"""The usual values of parameters that a file of a cluster leaves open."""

from typing import Any

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.constraints import MICROTICKS_US


def with_usual_values(fields: dict[str, Any]) -> Cluster:
    """Return a cluster of these fields; those of the controllers are filled in where missing.

    Raises:
        ClusterError: the fields are of no valid cluster.
    """
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
