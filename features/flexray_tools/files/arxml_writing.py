"""ARXML documents of a cluster and its slot table (AUTOSAR classic platform, schema 4.3).

Elements stand in the order of the schema. Signals and PDUs are not written.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.message_slot import MessageSlot
from concord.features.flexray_tools.files.arxml import (
    AR,
    CLOCK_TAGS,
    CLUSTER_TAGS,
    CONTROLLER_TAGS,
    channels_of,
    flexray_cluster,
    identifier,
)
from concord.features.flexray_tools.files.frame_triggerings import ecu_name, frame_name
from concord.features.flexray_tools.files.xml_document import (
    Element,
    Tag,
    XmlDocument,
    add,
    document_text,
    in_seconds,
    parse_document,
)

_HEAD = """<AUTOSAR xmlns="http://autosar.org/schema/r4.0"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://autosar.org/schema/r4.0 AUTOSAR_00044.xsd"><AR-PACKAGES/></AUTOSAR>"""
_SLOTS = "concord_slots"
_NAMES = tuple(
    AR + tag
    for tag in (
        "SHORT-NAME", "SHORT-NAME-FRAGMENTS", "LONG-NAME", "DESC", "CATEGORY", "ADMIN-DATA",
        "INTRODUCTION", "ANNOTATIONS",
    )
)  # fmt: skip


def cluster_to_arxml(cluster: Cluster, slots: Sequence[MessageSlot] = ()) -> str:
    """Return the ARXML document of a cluster, with an ECU that has the nodes' parameters and the
    key slots, and one for each node that sends. The fields in `WITHOUT_ELEMENT` are left out."""
    document = parse_document(_HEAD, "ARXML")
    elements = _package(document.root, "concord")
    named = identifier(cluster.name)
    fields = msgspec.structs.asdict(cluster)
    controllers = _add_controllers(elements, cluster, fields)
    element = _named(elements, "FLEXRAY-CLUSTER", named)
    if named != cluster.name:
        add(add(element, f"{AR}LONG-NAME"), f"{AR}L-4", cluster.name, L="FOR-ALL")
    variants = add(element, f"{AR}FLEXRAY-CLUSTER-VARIANTS")
    values = add(variants, f"{AR}FLEXRAY-CLUSTER-CONDITIONAL")
    add(values, f"{AR}BAUDRATE", round(cluster.bit_rate_mbps * 1e6))
    channels = add(values, f"{AR}PHYSICAL-CHANNELS")
    for letter in cluster.channels:
        channel = _named(channels, "FLEXRAY-PHYSICAL-CHANNEL", f"channel_{letter}")
        connectors = add(channel, f"{AR}COMM-CONNECTORS")
        for name in controllers:
            _refer_to_connector(connectors, f"/concord/node/connector_{name}_{letter}")
        add(channel, f"{AR}CHANNEL-NAME", f"CHANNEL-{letter}")
    stated: dict[str, object] = {
        "BIT": in_seconds(cluster.bit_us),
        "CYCLE-COUNT-MAX": cluster.number_of_cycles - 1,
        **_values(fields, CLUSTER_TAGS + CLOCK_TAGS),
    }
    for tag, value in sorted(stated.items()):
        add(values, AR + tag, value)
    _put_slots(document, element, slots)
    return document_text(document)


def arxml_with_slots(
    text: str | bytes, slots: Sequence[MessageSlot], name: str | None = None
) -> str:
    """Return an ARXML document with other frames on the channels of its cluster.

    Everything else is kept: signals, PDUs, and frames that no triggering names any more.

    Raises:
        ClusterFileError: the document describes no cluster, or several and no name.
    """
    document = parse_document(text, "ARXML")
    _put_slots(document, flexray_cluster(document.root, name), slots)
    return document_text(document)


def _put_slots(document: XmlDocument, cluster: Element, slots: Sequence[MessageSlot]) -> None:
    channels = channels_of(cluster, "cluster")
    _remove_slots(document.root, [channel for channel, _ in channels])
    if not slots:
        return
    elements = _package(document.root, _SLOTS)
    for slot in slots:
        frame = _named(elements, "FLEXRAY-FRAME", frame_name(slot))
        add(frame, f"{AR}FRAME-LENGTH", slot.payload_bytes)
    for node in sorted({slot.node for slot in slots}):
        _add_sender(elements, node, [slot for slot in slots if slot.node == node])
    for channel, letter in channels:
        sent = [slot for slot in slots if letter in slot.channel]
        connectors = _after_name(channel, "COMM-CONNECTORS")
        for node in sorted({slot.node for slot in sent}):
            name = ecu_name(node)
            _refer_to_connector(connectors, f"/{_SLOTS}/{name}/connector_{letter}")
        triggerings = Element(f"{AR}FRAME-TRIGGERINGS")
        channel.insert(list(channel).index(connectors) + 1, triggerings)
        for slot in sent:
            _trigger(triggerings, slot, letter)


def _remove_slots(root: Element, channels: Sequence[Element]) -> None:
    """Remove the triggerings of channels, and the package of a table that was put in before."""
    for packages in root.findall(f"{AR}AR-PACKAGES"):
        for old in [one for one in packages if one.findtext(f"{AR}SHORT-NAME") == _SLOTS]:
            packages.remove(old)
    for channel in channels:
        for triggerings in channel.findall(f"{AR}FRAME-TRIGGERINGS"):
            channel.remove(triggerings)
        for connectors in channel.findall(f"{AR}COMM-CONNECTORS"):
            for one in list(connectors):
                if any((reference.text or "").startswith(f"/{_SLOTS}/") for reference in one):
                    connectors.remove(one)


def _trigger(triggerings: Element, slot: MessageSlot, letter: str) -> None:
    name = frame_name(slot)
    one = _named(triggerings, "FLEXRAY-FRAME-TRIGGERING", f"triggering_{name}_{letter}")
    port = f"/{_SLOTS}/{ecu_name(slot.node)}/connector_{letter}/port_{name}"
    add(add(one, f"{AR}FRAME-PORT-REFS"), f"{AR}FRAME-PORT-REF", port, DEST="FRAME-PORT")
    add(one, f"{AR}FRAME-REF", f"/{_SLOTS}/{name}", DEST="FLEXRAY-FRAME")
    timings = add(one, f"{AR}ABSOLUTELY-SCHEDULED-TIMINGS")
    timing = add(timings, f"{AR}FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING")
    turn = add(add(timing, f"{AR}COMMUNICATION-CYCLE"), f"{AR}CYCLE-REPETITION")
    add(turn, f"{AR}BASE-CYCLE", slot.base_cycle)
    add(turn, f"{AR}CYCLE-REPETITION", f"CYCLE-REPETITION-{slot.repetition}")
    add(timing, f"{AR}SLOT-ID", slot.frame_id)


def _add_sender(elements: Element, node: int, slots: Sequence[MessageSlot]) -> None:
    """Add the ECU of a node, with a connector to each of its channels and a port for each frame."""
    ecu = _named(elements, "ECU-INSTANCE", ecu_name(node))
    controllers = add(ecu, f"{AR}COMM-CONTROLLERS")
    _named(controllers, "FLEXRAY-COMMUNICATION-CONTROLLER", "controller")
    connectors = add(ecu, f"{AR}CONNECTORS")
    for letter in sorted({letter for slot in slots for letter in slot.channel}):
        path = f"/{_SLOTS}/{ecu_name(node)}/controller"
        connector = _connector(connectors, f"connector_{letter}", path)
        ports = add(connector, f"{AR}ECU-COMM-PORT-INSTANCES")
        for slot in slots:
            if letter in slot.channel:
                port = _named(ports, "FRAME-PORT", f"port_{frame_name(slot)}")
                add(port, f"{AR}COMMUNICATION-DIRECTION", "OUT")


def _add_controllers(elements: Element, cluster: Cluster, fields: Mapping[str, Any]) -> list[str]:
    """Add the ECU with the nodes' parameters and a controller for each key slot; return their
    names."""
    ecu = _named(elements, "ECU-INSTANCE", "node")
    controllers, connectors = add(ecu, f"{AR}COMM-CONTROLLERS"), add(ecu, f"{AR}CONNECTORS")
    stated = {"controller": _values(fields, CONTROLLER_TAGS)}
    for slot in cluster.sync_slots:
        stated[f"controller_{slot}"] = {
            "KEY-SLOT-ID": slot,
            "KEY-SLOT-USED-FOR-START-UP": str(slot in cluster.startup_slots).lower(),
            "KEY-SLOT-USED-FOR-SYNC": "true",
        }
    for name, values in stated.items():
        controller = _named(controllers, "FLEXRAY-COMMUNICATION-CONTROLLER", name)
        variants = add(controller, f"{AR}FLEXRAY-COMMUNICATION-CONTROLLER-VARIANTS")
        values_of = add(variants, f"{AR}FLEXRAY-COMMUNICATION-CONTROLLER-CONDITIONAL")
        for tag, value in sorted(values.items()):
            add(values_of, AR + tag, value)
        for letter in cluster.channels:
            _connector(connectors, f"connector_{name}_{letter}", f"/concord/node/{name}")
    return list(stated)


def _connector(connectors: Element, name: str, controller: str) -> Element:
    connector = _named(connectors, "FLEXRAY-COMMUNICATION-CONNECTOR", name)
    kind = "FLEXRAY-COMMUNICATION-CONTROLLER"
    add(connector, f"{AR}COMM-CONTROLLER-REF", controller, DEST=kind)
    return connector


def _refer_to_connector(connectors: Element, path: str) -> None:
    conditional = add(connectors, f"{AR}COMMUNICATION-CONNECTOR-REF-CONDITIONAL")
    kind = "FLEXRAY-COMMUNICATION-CONNECTOR"
    add(conditional, f"{AR}COMMUNICATION-CONNECTOR-REF", path, DEST=kind)


def _values(fields: Mapping[str, Any], tags: Iterable[Tag]) -> dict[str, object]:
    """The values that a cluster states, times in seconds."""
    return {
        tag.name: in_seconds(fields[tag.field]) if tag.kind is float else fields[tag.field]
        for tag in tags
        if fields[tag.field] is not None
    }


def _package(root: Element, name: str) -> Element:
    packages = root.find(f"{AR}AR-PACKAGES")
    if packages is None:
        packages = add(root, f"{AR}AR-PACKAGES")
    return add(_named(packages, "AR-PACKAGE", name), f"{AR}ELEMENTS")


def _named(parent: Element, tag: str, name: str) -> Element:
    element = add(parent, AR + tag)
    add(element, f"{AR}SHORT-NAME", name)
    return element


def _after_name(element: Element, tag: str) -> Element:
    """Return a child that the schema has right after the names; it is added where it is missing."""
    found = element.find(AR + tag)
    if found is None:
        found = Element(AR + tag)
        names = [child for child in element if child.tag in _NAMES]
        element.insert(len(names), found)
    return found
