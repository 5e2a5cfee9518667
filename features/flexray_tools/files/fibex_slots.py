"""The slot table of a FIBEX document: frames that are triggered on the channels of its cluster."""

from collections.abc import Iterator, Mapping

from concord.bus.flexray.message_slot import MessageSlot
from concord.features.flexray_tools.files.fibex import (
    FLEXRAY,
    FX,
    HO,
    channels_of,
    flexray_cluster,
    text_of,
)
from concord.features.flexray_tools.files.frame_triggerings import Triggering, slots_of
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    Element,
    number,
    parse_document,
)


def slots_from_fibex(text: str | bytes, name: str | None = None) -> tuple[MessageSlot, ...]:
    """Return the frames that are triggered on the channels of a cluster; `name` chooses it
    where there are several.

    A frame comes from the ECU whose output port names its triggering.

    Raises:
        ClusterFileError: the document describes no cluster, or a triggering lacks its frame.
    """
    root = parse_document(text, "FIBEX").root
    element = flexray_cluster(root, name)
    cycles = 1 + (number(element, f"{FLEXRAY}CYCLE-COUNT-MAX", int, "cluster") or 63)
    senders = {
        reference.get("ID-REF"): text_of(ecu, HO, "SHORT-NAME", "ECU")
        for ecu in root.iter(f"{FX}ECU")
        for port in ecu.iter(f"{FX}OUTPUT-PORT")
        for reference in port.iter(f"{FX}FRAME-TRIGGERING-REF")
    }
    lengths = {
        frame.get("ID"): number(frame, f"{FX}BYTE-LENGTH", int, f"frame {frame.get('ID')}")
        for frame in root.iter(f"{FX}FRAME")
    }
    found = [
        triggering
        for channel, letter in channels_of(root, element)
        for one in channel.iter(f"{FX}FRAME-TRIGGERING")
        for triggering in _triggerings(one, letter, cycles, lengths, senders)
    ]
    used = {one.sender for one in found}
    names = [ecu.findtext(f"{HO}SHORT-NAME", "") for ecu in root.iter(f"{FX}ECU")]
    return slots_of(found, [one for one in names if one in used and one])


def _triggerings(
    element: Element,
    letter: str,
    cycles: int,
    lengths: Mapping[str | None, int | None],
    senders: Mapping[str | None, str],
) -> Iterator[Triggering]:
    name = element.get("ID", "?")
    where = f"frame triggering {name!r}"
    reference = element.find(f"{FX}FRAME-REF")
    frame = None if reference is None else reference.get("ID-REF")
    for timing in element.iter(f"{FX}ABSOLUTELY-SCHEDULED-TIMING"):
        length = lengths.get(frame)
        if frame is None or length is None:
            raise ClusterFileError(
                f"{where}: it refers to frame {frame!r}, which is not there or has no "
                "<BYTE-LENGTH>; add them"
            )
        slot, base, repetition, count = (
            number(timing, FX + tag, int, where)
            for tag in ("SLOT-ID", "BASE-CYCLE", "CYCLE-REPETITION", "CYCLE-COUNTER")
        )
        if slot is None:
            raise ClusterFileError(f"{where}: element <SLOT-ID> is missing; add it")
        if count is not None:
            base, repetition = count, cycles
        sender = senders.get(name, "")
        yield Triggering(frame, slot, base or 0, repetition or 1, letter, length, sender)
