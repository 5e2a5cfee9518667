"""The constraints of a cluster between its frames and the slots that hold them.

FlexRay protocol specification 2.1, appendix B; lengths hold for clocks that deviate by 1500 ppm.
"""

from collections.abc import Iterator

from concord.bus.flexray.cluster_parameters import ClusterParameters


def segment_violations(cluster: ClusterParameters) -> Iterator[str]:
    """Yield a sentence for each slot that is too short for its frame."""
    yield from _static_slot(cluster)
    if cluster.minislots == 0:
        return
    if cluster.minislot_action_point_macroticks >= cluster.minislot_macroticks:
        yield (
            "minislot action point (gdMinislotActionPointOffset < gdMinislot): "
            f"minislot_action_point_macroticks is {cluster.minislot_action_point_macroticks}, but "
            f"a minislot has {cluster.minislot_macroticks} macroticks; set a smaller offset"
        )
    yield from _latest_transmission(cluster)


def _static_slot(cluster: ClusterParameters) -> Iterator[str]:
    need = cluster.static_frame_macroticks(cluster.static_payload_bytes)
    if need > cluster.static_slot_macroticks:
        yield (
            "constraint 12 (gdStaticSlot >= 2 x gdActionPointOffset + frame + 11 idle bits, at "
            "1500 ppm): "
            f"static_slot_macroticks is {cluster.static_slot_macroticks}, but a frame of "
            f"{cluster.static_payload_bytes} bytes needs {need} macroticks; set "
            f"static_slot_macroticks to {need} or fewer static_payload_words"
        )


def _latest_transmission(cluster: ClusterParameters) -> Iterator[str]:
    latest = cluster.latest_start_minislot
    if cluster.latest_transmission_minislot > latest:
        longest = cluster.dynamic_slot_most_minislots(cluster.dynamic_payload_bytes)
        yield (
            "constraint 15 (pLatestTx <= gNumberOfMinislots - longest dynamic slot + 1, at 1500 "
            "ppm): "
            f"latest_transmission_minislot is {cluster.latest_transmission_minislot}, but a "
            f"dynamic frame of {cluster.dynamic_payload_bytes} bytes lasts {longest} of "
            f"{cluster.minislots} minislots; set latest_transmission_minislot to {latest} or fewer "
            "dynamic_payload_words"
        )
