"""AUTOSAR's exchange format (ARXML, classic platform, schema 4; written as schema 4.3).

A document has a FLEXRAY-CLUSTER, the FLEXRAY-COMMUNICATION-CONTROLLERs whose connectors are on its
channels, and the frames that ECUs send. Times are printed in seconds there. Variants and wake-up
are left alone, and signals and PDUs are not written. Elements stand in the order of the schema.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

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
    XmlDocument,
    add,
    as_number,
    document_text,
    in_seconds,
    microseconds,
    number,
    parse_document,
    section,
)

AR = "{http://autosar.org/schema/r4.0}"
_HEAD = """<AUTOSAR xmlns="http://autosar.org/schema/r4.0"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://autosar.org/schema/r4.0 AUTOSAR_00044.xsd"><AR-PACKAGES/></AUTOSAR>"""
_SLOTS = "concord_slots"
_CONTROLLER = "FLEXRAY-COMMUNICATION-CONTROLLER"
_TURN = "COMMUNICATION-CYCLE/CYCLE-REPETITION"
_NAMES = tuple(
    AR + tag
    for tag in (
        "SHORT-NAME", "SHORT-NAME-FRAGMENTS", "LONG-NAME", "DESC", "CATEGORY", "ADMIN-DATA",
        "INTRODUCTION", "ANNOTATIONS",
    )
)  # fmt: skip


def cluster_from_arxml(text: str | bytes, name: str | None = None) -> Cluster:
    """Return the FlexRay cluster of an ARXML document, as `read_cluster`."""
    return read_cluster(ARXML_FORMAT, text, name).cluster


def slots_from_arxml(text: str | bytes, name: str | None = None) -> tuple[MessageSlot, ...]:
    """Return the slot table of an ARXML document, as `read_slots`."""
    return read_slots(ARXML_FORMAT, text, name)


def cluster_to_arxml(cluster: Cluster, slots: Sequence[MessageSlot] = ()) -> str:
    """Return the ARXML document of a cluster, with an ECU that has the nodes' parameters and the
    key slots, and one for each node that sends. The fields in `WITHOUT_ELEMENT` are left out."""
    document = parse_document(_HEAD, "ARXML")
    elements = _package(document.root, "concord")
    named = _identifier(cluster.name)
    controllers = _add_controllers(elements, cluster)
    element = _named(elements, "FLEXRAY-CLUSTER", named)
    if named != cluster.name:
        _put(element, "LONG-NAME/L-4", cluster.name, L="FOR-ALL")
    values = _put(element, "FLEXRAY-CLUSTER-VARIANTS/FLEXRAY-CLUSTER-CONDITIONAL")
    _put(values, "BAUDRATE", round(cluster.bit_rate_mbps * 1e6))
    channels = _put(values, "PHYSICAL-CHANNELS")
    for letter in cluster.channels:
        channel = _named(channels, "FLEXRAY-PHYSICAL-CHANNEL", f"channel_{letter}")
        for name in controllers:
            connectors = section(channel, f"{AR}COMM-CONNECTORS")
            _refer_to_connector(connectors, f"/concord/node/connector_{name}_{letter}")
        _put(channel, "CHANNEL-NAME", f"CHANNEL-{letter}")
    stated: dict[str, object] = dict(ARXML_FORMAT.stated(cluster, "cluster", "clocks"))
    stated |= {"BIT": in_seconds(cluster.bit_us), "CYCLE-COUNT-MAX": cluster.number_of_cycles - 1}
    for tag, value in sorted(stated.items()):
        _put(values, tag, value)
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
    _put_slots(document, find_cluster(ARXML_FORMAT, document.root, name), slots)
    return document_text(document)


def _put_slots(document: XmlDocument, cluster: Element, slots: Sequence[MessageSlot]) -> None:
    channels = _channels(document.root, cluster)
    _remove_slots(document.root, [channel for channel, _ in channels])
    if not slots:
        return
    elements = _package(document.root, _SLOTS)
    latest = latest_of_nodes(
        slots, lambda: read_cluster(ARXML_FORMAT, document_text(document), _title(cluster)).cluster
    )
    for slot in slots:
        frame = _named(elements, "FLEXRAY-FRAME", frame_name(slot))
        _put(frame, "FRAME-LENGTH", slot.payload_bytes)
    for node in sorted({slot.node for slot in slots}):
        of_node = [slot for slot in slots if slot.node == node]
        _add_sender(elements, node, of_node, latest.get(node))
    for channel, letter in channels:
        sent = [slot for slot in slots if letter in slot.channel]
        connectors = _after_name(channel, "COMM-CONNECTORS")
        for node in sorted({slot.node for slot in sent}):
            _refer_to_connector(connectors, f"/{_SLOTS}/{ecu_name(node)}/connector_{letter}")
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
    _put(one, "FRAME-PORT-REFS/FRAME-PORT-REF", port, DEST="FRAME-PORT")
    _put(one, "FRAME-REF", f"/{_SLOTS}/{name}", DEST="FLEXRAY-FRAME")
    timing = _put(one, "ABSOLUTELY-SCHEDULED-TIMINGS/FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING")
    _put(timing, f"{_TURN}/BASE-CYCLE", slot.base_cycle)
    _put(timing, f"{_TURN}/CYCLE-REPETITION", f"CYCLE-REPETITION-{slot.repetition}")
    _put(timing, "SLOT-ID", slot.frame_id)


def _add_sender(
    elements: Element, node: int, slots: Sequence[MessageSlot], latest: int | None
) -> None:
    """Add the ECU of a node, with a connector to each of its channels and a port for each frame."""
    ecu = _named(elements, "ECU-INSTANCE", ecu_name(node))
    controller = _named(_put(ecu, "COMM-CONTROLLERS"), _CONTROLLER, "controller")
    if latest is not None:
        _put(controller, f"{_CONTROLLER}-VARIANTS/{_CONTROLLER}-CONDITIONAL/LATEST-TX", latest)
    connectors = _put(ecu, "CONNECTORS")
    for letter in sorted({letter for slot in slots for letter in slot.channel}):
        path = f"/{_SLOTS}/{ecu_name(node)}/controller"
        ports = _put(_connector(connectors, f"connector_{letter}", path), "ECU-COMM-PORT-INSTANCES")
        for slot in slots:
            if letter in slot.channel:
                port = _named(ports, "FRAME-PORT", f"port_{frame_name(slot)}")
                _put(port, "COMMUNICATION-DIRECTION", "OUT")


def _add_controllers(elements: Element, cluster: Cluster) -> list[str]:
    """Add the ECU with the nodes' parameters and a controller for each key slot; return their
    names."""
    ecu = _named(elements, "ECU-INSTANCE", "node")
    controllers, connectors = _put(ecu, "COMM-CONTROLLERS"), _put(ecu, "CONNECTORS")
    stated: dict[str, dict[str, object]] = {
        "controller": dict(ARXML_FORMAT.stated(cluster, "controller"))
    }
    for slot in cluster.sync_slots:
        starts = str(slot in cluster.startup_slots).lower()
        usage = {"KEY-SLOT-USED-FOR-START-UP": starts, "KEY-SLOT-USED-FOR-SYNC": "true"}
        stated[f"controller_{slot}"] = {"KEY-SLOT-ID": slot, **usage}
    for name, values in stated.items():
        controller = _named(controllers, _CONTROLLER, name)
        for tag, value in values.items():
            _put(controller, f"{_CONTROLLER}-VARIANTS/{_CONTROLLER}-CONDITIONAL/{tag}", value)
        for letter in cluster.channels:
            _connector(connectors, f"connector_{name}_{letter}", f"/concord/node/{name}")
    return list(stated)


def _connector(connectors: Element, name: str, controller: str) -> Element:
    connector = _named(connectors, "FLEXRAY-COMMUNICATION-CONNECTOR", name)
    _put(connector, "COMM-CONTROLLER-REF", controller, DEST=_CONTROLLER)
    return connector


def _refer_to_connector(connectors: Element, path: str) -> None:
    conditional = _put(connectors, "COMMUNICATION-CONNECTOR-REF-CONDITIONAL")
    kind = "FLEXRAY-COMMUNICATION-CONNECTOR"
    _put(conditional, "COMMUNICATION-CONNECTOR-REF", path, DEST=kind)


def _package(root: Element, name: str) -> Element:
    return _put(_named(section(root, f"{AR}AR-PACKAGES"), "AR-PACKAGE", name), "ELEMENTS")


def _named(parent: Element, tag: str, name: str) -> Element:
    element = _put(parent, tag)
    _put(element, "SHORT-NAME", name)
    return element


def _put(parent: Element, path: str, text: object = None, **attributes: str) -> Element:
    """Append the last element of a path, below elements that are added where they are missing."""
    *above, last = path.split("/")
    for tag in above:
        parent = section(parent, AR + tag)
    return add(parent, AR + last, text, **attributes)


def _after_name(element: Element, tag: str) -> Element:
    """Return a child that the schema has right after the names; it is added where it is missing."""
    found = element.find(AR + tag)
    if found is None:
        found = Element(AR + tag)
        names = [child for child in element if child.tag in _NAMES]
        element.insert(len(names), found)
    return found


def _short_name(element: Element) -> str:
    text = element.findtext(f"{AR}SHORT-NAME", "").strip()
    if not text:
        kind = element.tag.rpartition("}")[2]
        raise ClusterFileError(f"<{kind}>: element <SHORT-NAME> is missing; give it a name")
    return text


def _identifier(name: str) -> str:
    """Return the SHORT-NAME for a name: letters, digits and underscores, 128 at most."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:127]
    return plain if plain[:1].isalpha() else f"c{plain}"


def _title(cluster: Element) -> str:
    """Return the name of a cluster: its LONG-NAME, where the SHORT-NAME cannot spell it."""
    name = _short_name(cluster)
    long = cluster.findtext(f"{AR}LONG-NAME/{AR}L-4", "")
    return long if _identifier(long) == name else name


def _conditional(element: Element, kind: str) -> Element:
    """Return the element with the values of a cluster or controller: its variant, or itself."""
    variants = element.findall(f"{AR}{kind}-VARIANTS/{AR}{kind}-CONDITIONAL")
    if len(variants) > 1:
        raise ClusterFileError(
            f"<{kind}> {_short_name(element)!r}: it has {len(variants)} variants; export one of "
            "them"
        )
    return variants[0] if variants else element


def _channels(root: Element, cluster: Element, where: str = "cluster") -> list[tuple[Element, str]]:
    """Return the physical channels of a cluster, each with its letter."""
    found: list[tuple[Element, str]] = []
    for channel in cluster.iter(f"{AR}FLEXRAY-PHYSICAL-CHANNEL"):
        letter = channel.findtext(f"{AR}CHANNEL-NAME", "").strip().removeprefix("CHANNEL-")
        if letter not in ("A", "B"):
            raise ClusterFileError(
                f"{where}: channel {_short_name(channel)!r} has <CHANNEL-NAME> {letter!r}; it must "
                "be CHANNEL-A or CHANNEL-B"
            )
        found.append((channel, letter))
    return found


def element_paths(root: Element) -> dict[str, Element]:
    """Return the elements with a SHORT-NAME by their paths, as references name them."""
    found: dict[str, Element] = {}
    waiting = [(root, "")]
    while waiting:
        element, above = waiting.pop()
        name = element.findtext(f"{AR}SHORT-NAME")
        path = above if name is None else f"{above}/{name.strip()}"
        if name is not None:
            found[path] = element
        waiting += [(child, path) for child in element]
    return found


def _controllers(root: Element, cluster: Element, where: str) -> list[Element]:
    """Return the controllers whose connectors are on the channels; all where none is connected."""
    named = element_paths(root)
    connected = []
    for channel, _ in _channels(root, cluster, where):
        for reference in channel.iter(f"{AR}COMMUNICATION-CONNECTOR-REF"):
            connector = named.get((reference.text or "").strip())
            if connector is not None:
                path = connector.findtext(f"{AR}COMM-CONTROLLER-REF", "").strip()
                connected += [named[path]] if path in named else []
    every = list(root.iter(AR + _CONTROLLER))
    kept = [one for one in every if one in connected or not connected]
    return [_conditional(one, _CONTROLLER) for one in kept]


def _key_slots(controllers: Sequence[Element]) -> tuple[list[int], list[int]]:
    found: list[list[int]] = []
    for usage in ("KEY-SLOT-USED-FOR-SYNC", "KEY-SLOT-USED-FOR-START-UP"):
        slots = {
            number(one, f"{AR}KEY-SLOT-ID", int, "controller")
            for one in controllers
            if one.findtext(AR + usage, "").strip().lower() in ("true", "1")
        }
        if None in slots:
            raise ClusterFileError(f"controller: <{usage}> is true, but <KEY-SLOT-ID> is missing")
        found.append(sorted(slots))
    return found[0], found[1]


def _frames(root: Element) -> Callable[[Element], FoundFrame]:
    named = element_paths(root)

    def frame_of(triggering: Element) -> FoundFrame:
        where = f"frame triggering {_short_name(triggering)!r}"
        path = triggering.findtext(f"{AR}FRAME-REF", "").strip()
        frame = named.get(path)
        length = None if frame is None else number(frame, f"{AR}FRAME-LENGTH", int, where)
        return where, path, length, *_sender(triggering, named)

    return frame_of


def _sender(element: Element, named: Mapping[str, Element]) -> tuple[str, Element | None]:
    """Return the ECU with the output port of a triggering, "" where no port is one, and the
    controller of the port's connector."""
    for reference in element.iter(f"{AR}FRAME-PORT-REF"):
        path = (reference.text or "").strip()
        port = named.get(path)
        if port is not None and port.findtext(f"{AR}COMMUNICATION-DIRECTION", "").strip() == "OUT":
            above, controller = path, None
            while above:
                above = above.rpartition("/")[0]
                one = named.get(above)
                if one is None:
                    continue
                used = one.findtext(f"{AR}COMM-CONTROLLER-REF", "").strip()
                controller = named.get(used, controller)
                if one.tag == f"{AR}ECU-INSTANCE":
                    found = None if controller is None else _conditional(controller, _CONTROLLER)
                    return _short_name(one), found
    return "", None


def _turn(timing: Element, cycles: int, where: str) -> tuple[int | None, int | None, int]:
    slot = number(timing, f"{AR}SLOT-ID", int, where)
    turn = timing.find(f"{AR}COMMUNICATION-CYCLE/{AR}CYCLE-REPETITION")
    count = timing.find(f"{AR}COMMUNICATION-CYCLE/{AR}CYCLE-COUNTER")
    if turn is not None:
        word = turn.findtext(f"{AR}CYCLE-REPETITION", "1").strip()
        base = number(turn, f"{AR}BASE-CYCLE", int, where)
        plain = word.removeprefix("CYCLE-REPETITION-")
        return slot, base, as_number(plain, int, f"{where}: <CYCLE-REPETITION>")
    if count is not None:
        return slot, number(count, f"{AR}CYCLE-COUNTER", int, where), cycles
    return slot, 0, 1


ARXML_FORMAT = Format(
    name="ARXML",
    standard="AUTOSAR",
    space=AR,
    prefix="",
    in_fibex=False,
    time_us=microseconds,
    time_text=in_seconds,
    rate=f"{AR}BAUDRATE",
    length="FRAME-LENGTH",
    cluster=(
        "FLEXRAY-CLUSTER",
        "<FLEXRAY-CLUSTER> of the name space http://autosar.org/schema/r4.0; export the system "
        "with its FlexRay cluster",
    ),
    parent="FLEXRAY-CLUSTER-CONDITIONAL",
    no_channel=(
        f"{AR}FLEXRAY-PHYSICAL-CHANNEL",
        "<FLEXRAY-PHYSICAL-CHANNEL> (with <CHANNEL-NAME> CHANNEL-A or CHANNEL-B)",
    ),
    no_rate="<BAUDRATE> or <BIT> (the bit rate)",
    triggering=f"{AR}FLEXRAY-FRAME-TRIGGERING",
    timing=f"{AR}FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING",
    clusters=lambda root: {_title(one): one for one in root.iter(f"{AR}FLEXRAY-CLUSTER")},
    title=_title,
    values=lambda cluster: _conditional(cluster, "FLEXRAY-CLUSTER"),
    letters=lambda *found: "".join(sorted(letter for _, letter in _channels(*found))),
    channels=_channels,
    controllers=_controllers,
    key_slots=_key_slots,
    frames=_frames,
    turn=_turn,
    ecu_names=lambda root: [_short_name(one) for one in root.iter(f"{AR}ECU-INSTANCE")],
)
WITHOUT_ELEMENT = ARXML_FORMAT.lacking()
"""Fields of a cluster for which AUTOSAR has no element."""
ARXML = ClusterFileFormat(partial(read_cluster, ARXML_FORMAT), slots_from_arxml)
"""The readers of AUTOSAR files."""
