"""The slot table of a recording: each frame ID with its longest payload."""

from concord.bus.flexray.message_slot import MessageSlot
from concord.features.flexray_tools.recordings.decoder import Decoding
from concord.features.flexray_tools.recordings.fit import Fit


def recorded_slots(decoding: Decoding, fitted: Fit) -> tuple[MessageSlot, ...]:
    """Return a slot for each frame ID that a recording shows, with the multiplexing it proves.

    A recording does not name senders: every slot gets a node of its own, in order of IDs.
    """
    longest: dict[int, int] = {}
    for decoded in decoding.frames:
        if decoded.header_crc_ok and decoded.frame_crc_ok:
            frame = decoded.frame
            longest[frame.frame_id] = max(longest.get(frame.frame_id, 0), len(frame.payload))
    claims = {entry.frame_id: entry for entry in fitted.multiplexing if entry.repetition}
    return tuple(
        MessageSlot(
            frame_id=frame_id,
            payload_bytes=longest[frame_id],
            node=node,
            channel=decoding.channel,
            base_cycle=claims[frame_id].base_cycle or 0 if frame_id in claims else 0,
            repetition=claims[frame_id].repetition or 1 if frame_id in claims else 1,
        )
        for node, frame_id in enumerate(sorted(longest))
    )
