"""FIBEX, the exchange format of FlexRay tools (ASAM MCD-2 NET, versions 2 to 4).

A document has a cluster, its channels and, in some files, the controllers on these channels
(pLatestTx, microtick, longest dynamic payload, corrections, key slots), and the frames that ECUs
send. Wake-up is left alone, and signals are not written. The sections and their order are those of
FIBEX 2 to 4.
"""

from collections.abc import Callable, Sequence
from functools import partial
from xml.sax.saxutils import escape

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_files import ClusterFileFormat
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.features.flexray_tools.files.exchange import (
    Format,
    FoundFrame,
    ecu_name,
    find_cluster,
    frame_name,
    latest_of_nodes,
    read_cluster,
    read_slots,
)
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    Element,
    add,
    document_text,
    number,
    parse_document,
    section,
)

FX = "{http://www.asam.net/xml/fbx}"
FLEXRAY = "{http://www.asam.net/xml/fbx/flexray}"
HO = "{http://www.asam.net/xml}"
_XSI = "{http://www.w3.org/2001/XMLSchema-instance}"


def cluster_from_fibex(text: str | bytes, name: str | None = None) -> Cluster:
    """Return the FlexRay cluster of a FIBEX document, as `read_cluster`."""
    return read_cluster(FIBEX_FORMAT, text, name).cluster


def slots_from_fibex(text: str | bytes, name: str | None = None) -> tuple[MessageSlot, ...]:
    """Return the slot table of a FIBEX document, as `read_slots`."""
    return read_slots(FIBEX_FORMAT, text, name)


def cluster_to_fibex(cluster: Cluster, slots: Sequence[MessageSlot] = ()) -> str:
    """Return the FIBEX document of a cluster, with one controller that has the nodes' parameters,
    one for each key slot, and an ECU for each node that sends. The fields in `WITHOUT_ELEMENT` are
    left out."""
    text = _cluster_text(cluster)
    return fibex_with_slots(text, slots) if slots else text


def fibex_with_slots(
    text: str | bytes, slots: Sequence[MessageSlot], name: str | None = None
) -> str:
    """Return a FIBEX document with other frames on the channels of its cluster.

    Everything else is kept: signals, PDUs, and frames that no triggering names any more.

    Raises:
        ClusterFileError: the document describes no cluster, or several and no name.
    """
    document = parse_document(text, "FIBEX")
    root = document.root
    latest = latest_of_nodes(slots, lambda: cluster_from_fibex(text, name))
    channels = _channels(root, find_cluster(FIBEX_FORMAT, root, name))
    _remove_slots(root, [channel for channel, _ in channels])
    elements = section(root, f"{FX}ELEMENTS")
    frames, ecus = section(elements, f"{FX}FRAMES"), section(elements, f"{FX}ECUS")
    known = {frame.get("ID"): frame for frame in frames}
    for slot in slots:
        if frame_name(slot) in known:
            frames.remove(known[frame_name(slot)])
        frame = add(frames, f"{FX}FRAME", ID=frame_name(slot))
        add(frame, f"{HO}SHORT-NAME", frame_name(slot))
        add(frame, f"{FX}BYTE-LENGTH", slot.payload_bytes)
        add(frame, f"{FX}FRAME-TYPE", "APPLICATION")
    for channel, letter in channels:
        sent = [slot for slot in slots if letter in slot.channel]
        triggerings = section(channel, f"{FX}FRAME-TRIGGERINGS")
        for slot in sent:
            _trigger(triggerings, slot, letter)
        for node in sorted({slot.node for slot in sent}):
            of_node = [slot for slot in sent if slot.node == node]
            _connect(ecus, node, channel.get("ID", ""), letter, of_node)
    for node, minislot in latest.items():
        place = f"{FX}CONTROLLER[@ID='controller_of_{ecu_name(node)}']"
        for controller in root.findall(f".//{place}"):
            add(controller, f"{FLEXRAY}LATEST-TX", minislot)
    return document_text(document)


def _remove_slots(root: Element, channels: Sequence[Element]) -> None:
    """Remove the triggerings of channels, and the ports of these."""
    gone = {one.get("ID") for channel in channels for one in channel.iter(FIBEX_FORMAT.triggering)}
    for channel in channels:
        for triggerings in channel.findall(f"{FX}FRAME-TRIGGERINGS"):
            channel.remove(triggerings)
    for parent in root.iter():
        for port in [one for one in parent if one.tag in (f"{FX}INPUT-PORT", f"{FX}OUTPUT-PORT")]:
            if not gone.isdisjoint(_references(port, "FRAME-TRIGGERING-REF")):
                parent.remove(port)


def _trigger(triggerings: Element, slot: MessageSlot, letter: str) -> None:
    one = add(triggerings, f"{FX}FRAME-TRIGGERING", ID=_triggering_name(slot, letter))
    timing = add(add(one, f"{FX}TIMINGS"), f"{FX}ABSOLUTELY-SCHEDULED-TIMING")
    add(timing, f"{FX}SLOT-ID", slot.frame_id)
    add(timing, f"{FX}BASE-CYCLE", slot.base_cycle)
    add(timing, f"{FX}CYCLE-REPETITION", slot.repetition)
    add(one, f"{FX}FRAME-REF", **{"ID-REF": frame_name(slot)})


def _connect(
    ecus: Element, node: int, channel: str, letter: str, slots: Sequence[MessageSlot]
) -> None:
    """Give the ECU of a node a connector to a channel, with an output port for each frame."""
    name = ecu_name(node)
    ecu = next((one for one in ecus if one.get("ID") == name), None)
    if ecu is None:
        ecu = add(ecus, f"{FX}ECU", ID=name)
        add(ecu, f"{HO}SHORT-NAME", name)
        controllers = add(ecu, f"{FX}CONTROLLERS")
        kind = {f"{_XSI}type": "flexray:CONTROLLER-TYPE"}
        controller = add(controllers, f"{FX}CONTROLLER", ID=f"controller_of_{name}", **kind)
        add(controller, f"{HO}SHORT-NAME", f"controller_of_{name}")
    connectors = section(ecu, f"{FX}CONNECTORS")
    place = f"connector_{name}_{letter}"
    for old in [one for one in connectors if one.get("ID") == place]:
        connectors.remove(old)
    connector = add(connectors, f"{FX}CONNECTOR", ID=place)
    add(connector, f"{FX}CHANNEL-REF", **{"ID-REF": channel})
    add(connector, f"{FX}CONTROLLER-REF", **{"ID-REF": f"controller_of_{name}"})
    outputs = add(connector, f"{FX}OUTPUTS")
    for slot in slots:
        triggering = _triggering_name(slot, letter)
        port = add(outputs, f"{FX}OUTPUT-PORT", ID=f"output_{triggering}")
        add(port, f"{FX}FRAME-TRIGGERING-REF", **{"ID-REF": triggering})


def _triggering_name(slot: MessageSlot, letter: str) -> str:
    return f"triggering_{frame_name(slot)}_{letter}"


def _cluster_text(cluster: Cluster) -> str:
    key_slots = "".join(
        f"""
      <fx:CONTROLLER ID="controller_{slot}" xsi:type="flexray:CONTROLLER-TYPE">
        <ho:SHORT-NAME>controller_{slot}</ho:SHORT-NAME>
        <flexray:KEY-SLOT-USAGE><flexray:{usage}>{slot}</flexray:{usage}></flexray:KEY-SLOT-USAGE>
      </fx:CONTROLLER>"""
        for slot in cluster.sync_slots
        for usage in ("STARTUP-SYNC" if slot in cluster.startup_slots else "SYNC",)
    )
    channel_refs = "".join(
        f'<fx:CHANNEL-REF ID-REF="channel_{letter}"/>' for letter in cluster.channels
    )
    channels = "\n".join(
        f'      <fx:CHANNEL ID="channel_{letter}" xsi:type="flexray:CHANNEL-TYPE">'
        f"<ho:SHORT-NAME>Channel_{letter}</ho:SHORT-NAME>"
        f"<flexray:FLEXRAY-CHANNEL-NAME>{letter}</flexray:FLEXRAY-CHANNEL-NAME></fx:CHANNEL>"
        for letter in cluster.channels
    )
    controllers = ["controller", *(f"controller_{slot}" for slot in cluster.sync_slots)]
    connectors = "".join(
        f"""
      <fx:CONNECTOR ID="connector_{name}_{letter}"><fx:CHANNEL-REF ID-REF="channel_{letter}"/>"""
        f'<fx:CONTROLLER-REF ID-REF="{name}"/></fx:CONNECTOR>'
        for name in controllers
        for letter in cluster.channels
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fx:FIBEX xmlns:fx="http://www.asam.net/xml/fbx" xmlns:ho="http://www.asam.net/xml"
 xmlns:flexray="http://www.asam.net/xml/fbx/flexray"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" VERSION="2.0.1">
  <fx:PROJECT ID="project"><ho:SHORT-NAME>concord</ho:SHORT-NAME></fx:PROJECT>
  <fx:ELEMENTS>
    <fx:CLUSTERS>
      <fx:CLUSTER ID="cluster" xsi:type="flexray:CLUSTER-TYPE">
        <ho:SHORT-NAME>{escape(cluster.name)}</ho:SHORT-NAME>
        <fx:SPEED>{round(cluster.bit_rate_mbps * 1e6)}</fx:SPEED>
        <fx:IS-HIGH-LOW-BIT-ORDER>true</fx:IS-HIGH-LOW-BIT-ORDER>
        <fx:BIT-COUNTING-POLICY>MONOTONE</fx:BIT-COUNTING-POLICY>
        <fx:PROTOCOL xsi:type="flexray:PROTOCOL-TYPE">FlexRay</fx:PROTOCOL>
        <fx:CHANNEL-REFS>{channel_refs}</fx:CHANNEL-REFS>
        <flexray:CYCLE-COUNT-MAX>{cluster.number_of_cycles - 1}</flexray:CYCLE-COUNT-MAX>
{_lines(cluster, "cluster", "clocks")}
        <flexray:BIT>{cluster.bit_us!r}</flexray:BIT>
      </fx:CLUSTER>
    </fx:CLUSTERS>
    <fx:CHANNELS>
{channels}
    </fx:CHANNELS>
    <fx:ECUS><fx:ECU ID="ecu"><ho:SHORT-NAME>node</ho:SHORT-NAME><fx:CONTROLLERS>
      <fx:CONTROLLER ID="controller" xsi:type="flexray:CONTROLLER-TYPE">
        <ho:SHORT-NAME>controller</ho:SHORT-NAME>
{_lines(cluster, "controller")}
      </fx:CONTROLLER>{key_slots}
    </fx:CONTROLLERS><fx:CONNECTORS>{connectors}
    </fx:CONNECTORS></fx:ECU></fx:ECUS>
  </fx:ELEMENTS>
</fx:FIBEX>
"""


def _lines(cluster: Cluster, *parts: str) -> str:
    return "\n".join(
        f"        <flexray:{tag}>{text}</flexray:{tag}>"
        for tag, text in FIBEX_FORMAT.stated(cluster, *parts)
    )


def _references(element: Element, tag: str) -> list[str | None]:
    """Return the elements that those of a name below an element refer to."""
    return [reference.get("ID-REF") for reference in element.iter(FX + tag)]


def _clusters(root: Element) -> dict[str, Element]:
    """Return the clusters with elements of FlexRay's name space (a file may describe CAN, too)."""
    return {
        element.findtext(f"{HO}SHORT-NAME", ""): element
        for element in root.iter(f"{FX}CLUSTER")
        if any(str(child.tag).startswith(FLEXRAY) for child in element)
    }


def _title(element: Element, where: str = "cluster") -> str:
    text = element.findtext(f"{HO}SHORT-NAME", "")
    if not text.strip():
        raise ClusterFileError(f"{where}: element <SHORT-NAME> is missing; give the {where} a name")
    return text


def _channels(root: Element, element: Element) -> list[tuple[Element, str]]:
    """Return the channels of a cluster with their letters; one that refers to none has all."""
    references = set(_references(element, "CHANNEL-REF"))
    found = [
        (channel, channel.findtext(f"{FLEXRAY}FLEXRAY-CHANNEL-NAME", "").strip())
        for channel in root.iter(f"{FX}CHANNEL")
        if channel.get("ID") in references or not references
    ]
    return [one for one in found if references or one[1] in ("A", "B")]


def _letters(root: Element, element: Element, where: str) -> str:
    names = {channel.get("ID"): letter for channel, letter in _channels(root, element)}
    references = _references(element, "CHANNEL-REF") or list(names)
    lost = [reference for reference in references if names.get(reference) not in ("A", "B")]
    if lost:
        raise ClusterFileError(
            f"{where}: <CHANNEL-REF> {lost}; it must refer to a <CHANNEL> with "
            "<FLEXRAY-CHANNEL-NAME> A or B"
        )
    return "".join(sorted({names[reference] for reference in references}))


def _controllers(root: Element, element: Element, where: str) -> list[Element]:
    """The controllers that connectors put on the cluster's channels; all where there are none."""
    channels = {channel.get("ID") for channel, _ in _channels(root, element)}
    connected: dict[str | None, bool] = {}
    for connector in root.iter(f"{FX}CONNECTOR"):
        on = bool(channels.intersection(_references(connector, "CHANNEL-REF")))
        for name in _references(connector, "CONTROLLER-REF"):
            connected[name] = connected.get(name, False) or on
    return [
        controller
        for controller in root.iter(f"{FX}CONTROLLER")
        if connected.get(controller.get("ID"), not connected)
    ]


def _key_slots(controllers: Sequence[Element]) -> tuple[list[int], list[int]]:
    found: dict[str, set[int]] = {"SYNC": set(), "STARTUP-SYNC": set()}
    usages = [usage for one in controllers for usage in one.iter(f"{FLEXRAY}KEY-SLOT-USAGE")]
    for name, slots in found.items():
        for slot in (slot for usage in usages for slot in usage.findall(FLEXRAY + name)):
            text = (slot.text or "").strip()
            if not text.isdecimal():
                raise ClusterFileError(
                    f"controller: <KEY-SLOT-USAGE> says {text[:40]!r}, but must be a slot"
                )
            slots.add(int(text))
    return sorted(found["SYNC"]), sorted(found["STARTUP-SYNC"])


def _frames(root: Element) -> Callable[[Element], FoundFrame]:
    controllers = {one.get("ID"): one for one in root.iter(f"{FX}CONTROLLER")}
    senders: dict[str | None, tuple[str, Element | None]] = {}
    for ecu in root.iter(f"{FX}ECU"):
        own = list(ecu.iter(f"{FX}CONTROLLER"))
        only = own[0] if len(own) == 1 else None
        for connector in [*ecu.iter(f"{FX}CONNECTOR"), ecu]:
            named = _references(connector, "CONTROLLER-REF") if connector is not ecu else []
            controller = controllers.get(named[0]) if named else only
            for port in connector.iter(f"{FX}OUTPUT-PORT"):
                for triggering in _references(port, "FRAME-TRIGGERING-REF"):
                    senders.setdefault(triggering, (_title(ecu, "ECU"), controller))
    lengths = {
        frame.get("ID"): number(frame, f"{FX}BYTE-LENGTH", int, f"frame {frame.get('ID')}")
        for frame in root.iter(f"{FX}FRAME")
    }

    def frame_of(triggering: Element) -> FoundFrame:
        name = triggering.get("ID", "?")
        reference = triggering.find(f"{FX}FRAME-REF")
        frame = None if reference is None else reference.get("ID-REF")
        sender, controller = senders.get(name, ("", None))
        return f"frame triggering {name!r}", frame, lengths.get(frame), sender, controller

    return frame_of


def _turn(timing: Element, cycles: int, where: str) -> tuple[int | None, int | None, int]:
    slot, base, repetition, count = (
        number(timing, FX + tag, int, where)
        for tag in ("SLOT-ID", "BASE-CYCLE", "CYCLE-REPETITION", "CYCLE-COUNTER")
    )
    return (slot, base, repetition or 1) if count is None else (slot, count, cycles)


FIBEX_FORMAT = Format(
    name="FIBEX",
    standard="FIBEX",
    space=FLEXRAY,
    prefix="flexray:",
    in_fibex=True,
    time_us=float,
    time_text=repr,
    rate=f"{FX}SPEED",
    length="BYTE-LENGTH",
    cluster=(
        "CLUSTER",
        "<CLUSTER> of type flexray:CLUSTER-TYPE; export the FlexRay cluster",
    ),
    parent="CLUSTER",
    no_channel=(
        f"{FX}CHANNEL-REF",
        "<CHANNEL-REF> (to a <CHANNEL> with <FLEXRAY-CHANNEL-NAME> A or B)",
    ),
    no_rate="<SPEED> and <BIT> (the bit rate)",
    triggering=f"{FX}FRAME-TRIGGERING",
    timing=f"{FX}ABSOLUTELY-SCHEDULED-TIMING",
    clusters=_clusters,
    title=_title,
    values=lambda element: element,
    letters=_letters,
    channels=_channels,
    controllers=_controllers,
    key_slots=_key_slots,
    frames=_frames,
    turn=_turn,
    ecu_names=lambda root: [one.findtext(f"{HO}SHORT-NAME", "") for one in root.iter(f"{FX}ECU")],
)
WITHOUT_ELEMENT = FIBEX_FORMAT.lacking()
"""Fields of a cluster for which FIBEX has no element."""
FIBEX = ClusterFileFormat(partial(read_cluster, FIBEX_FORMAT), slots_from_fibex)
"""The readers of FIBEX files."""
