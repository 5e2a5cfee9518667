"""The slot table of an ARXML document: frames that are triggered on the channels of its cluster."""

from collections.abc import Iterator, Mapping

from concord.bus.flexray.message_slot import MessageSlot
from concord.features.flexray_tools.files.arxml import (
    AR,
    channels_of,
    conditional,
    flexray_cluster,
    paths_of,
    short_name,
)
from concord.features.flexray_tools.files.frame_triggerings import Triggering, slots_of
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    Element,
    as_number,
    number,
    parse_document,
)


def slots_from_arxml(text: str | bytes, name: str | None = None) -> tuple[MessageSlot, ...]:
    """Return the frames that are triggered on the channels of a cluster; `name` chooses it where
    there are several.

    A frame comes from the ECU whose frame port of direction OUT its triggering names.

    Raises:
        ClusterFileError: the document describes no cluster, or a triggering lacks its frame.
    """
    root = parse_document(text, "ARXML").root
    cluster = flexray_cluster(root, name)
    values = conditional(cluster, "FLEXRAY-CLUSTER")
    cycles = 1 + (number(values, f"{AR}CYCLE-COUNT-MAX", int, "cluster") or 63)
    named = paths_of(root)
    found = [
        triggering
        for channel, letter in channels_of(cluster, "cluster")
        for one in channel.iter(f"{AR}FLEXRAY-FRAME-TRIGGERING")
        for triggering in _triggerings(one, letter, cycles, named)
    ]
    used = {one.sender for one in found}
    names = [short_name(one) for one in root.iter(f"{AR}ECU-INSTANCE")]
    return slots_of(found, [one for one in names if one in used])


def _triggerings(
    element: Element, letter: str, cycles: int, named: Mapping[str, Element]
) -> Iterator[Triggering]:
    where = f"frame triggering {short_name(element)!r}"
    path = element.findtext(f"{AR}FRAME-REF", "").strip()
    frame = named.get(path)
    length = None if frame is None else number(frame, f"{AR}FRAME-LENGTH", int, where)
    if length is None:
        raise ClusterFileError(
            f"{where}: it refers to frame {path!r}, which is not there or has no <FRAME-LENGTH>; "
            "add them"
        )
    sender = _sender(element, named)
    for timing in element.iter(f"{AR}FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING"):
        slot = number(timing, f"{AR}SLOT-ID", int, where)
        if slot is None:
            raise ClusterFileError(f"{where}: element <SLOT-ID> is missing; add it")
        turn = timing.find(f"{AR}COMMUNICATION-CYCLE/{AR}CYCLE-REPETITION")
        count = timing.find(f"{AR}COMMUNICATION-CYCLE/{AR}CYCLE-COUNTER")
        base, repetition = 0, 1
        if turn is not None:
            base = number(turn, f"{AR}BASE-CYCLE", int, where) or 0
            word = turn.findtext(f"{AR}CYCLE-REPETITION", "1").strip()
            plain = word.removeprefix("CYCLE-REPETITION-")
            repetition = as_number(plain, int, f"{where}: <CYCLE-REPETITION>")
        elif count is not None:
            base = number(count, f"{AR}CYCLE-COUNTER", int, where) or 0
            repetition = cycles
        yield Triggering(path, slot, base, repetition, letter, length, sender)


def _sender(element: Element, named: Mapping[str, Element]) -> str:
    """Return the ECU with the output port of a triggering, "" where no port is one."""
    for reference in element.iter(f"{AR}FRAME-PORT-REF"):
        path = (reference.text or "").strip()
        port = named.get(path)
        if port is not None and port.findtext(f"{AR}COMMUNICATION-DIRECTION", "").strip() == "OUT":
            above = path
            while above:
                above = above.rpartition("/")[0]
                if above in named and named[above].tag == f"{AR}ECU-INSTANCE":
                    return short_name(named[above])
    return ""
