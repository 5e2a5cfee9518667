"""FIBEX documents of a cluster and its slot table.

The sections and their order are those of FIBEX 2 to 4; signals are not written.
"""

from collections.abc import Iterable, Sequence
from typing import Any
from xml.sax.saxutils import escape

import msgspec

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.message_slot import MessageSlot
from concord.features.flexray_tools.files.fibex import (
    CLOCK_TAGS,
    CLUSTER_TAGS,
    CONTROLLER_TAGS,
    CORRECTION_TAGS,
    FX,
    HO,
    channels_of,
    flexray_cluster,
)
from concord.features.flexray_tools.files.frame_triggerings import ecu_name, frame_name
from concord.features.flexray_tools.files.xml_document import (
    Element,
    Tag,
    add,
    document_text,
    parse_document,
    section,
)

_XSI = "{http://www.w3.org/2001/XMLSchema-instance}"


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
    channels = channels_of(root, flexray_cluster(root, name))
    gone = {
        one.get("ID") for channel, _ in channels for one in channel.iter(f"{FX}FRAME-TRIGGERING")
    }
    for channel, _ in channels:
        for triggerings in channel.findall(f"{FX}FRAME-TRIGGERINGS"):
            channel.remove(triggerings)
    _without_ports(root, gone)
    elements = section(root, f"{FX}ELEMENTS")
    frames, ecus = section(elements, f"{FX}FRAMES"), section(elements, f"{FX}ECUS")
    known = {frame.get("ID"): frame for frame in frames}
    for slot in slots:
        frame = known.get(frame_name(slot))
        if frame is not None:
            frames.remove(frame)
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
    return document_text(document)


def _without_ports(root: Element, gone: set[str | None]) -> None:
    """Remove the ports of triggerings that are gone."""
    for tag in ("INPUT-PORT", "OUTPUT-PORT"):
        for parent in root.iter():
            for port in parent.findall(FX + tag):
                if any(one.get("ID-REF") in gone for one in port.iter(f"{FX}FRAME-TRIGGERING-REF")):
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
    found = [one for one in ecus if one.get("ID") == name]
    if found:
        (ecu,) = found
    else:
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
    fields = msgspec.structs.asdict(cluster)
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
{_lines(fields, CLUSTER_TAGS + CLOCK_TAGS)}
        <flexray:BIT>{cluster.bit_us!r}</flexray:BIT>
      </fx:CLUSTER>
    </fx:CLUSTERS>
    <fx:CHANNELS>
{channels}
    </fx:CHANNELS>
    <fx:ECUS><fx:ECU ID="ecu"><ho:SHORT-NAME>node</ho:SHORT-NAME><fx:CONTROLLERS>
      <fx:CONTROLLER ID="controller" xsi:type="flexray:CONTROLLER-TYPE">
        <ho:SHORT-NAME>controller</ho:SHORT-NAME>
{_lines(fields, CONTROLLER_TAGS + CORRECTION_TAGS)}
      </fx:CONTROLLER>{key_slots}
    </fx:CONTROLLERS><fx:CONNECTORS>{connectors}
    </fx:CONNECTORS></fx:ECU></fx:ECUS>
  </fx:ELEMENTS>
</fx:FIBEX>
"""


def _lines(fields: dict[str, Any], tags: Iterable[Tag]) -> str:
    return "\n".join(
        f"        <flexray:{tag.name}>{fields[tag.field]!r}</flexray:{tag.name}>"
        for tag in tags
        if fields[tag.field] is not None
    )
