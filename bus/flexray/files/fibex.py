"""Clusters in FIBEX, the exchange format of FlexRay tools (ASAM MCD-2 NET, versions 2 to 4).

Reads a cluster, its channels and, where a file has them, the controllers on these channels
(pLatestTx, microtick, longest dynamic payload, corrections, key slots). Frames, signals and wake-up
are left alone, and are not written.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import msgspec

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.constraints import MICROTICKS_US

Element = ElementTree.Element

_FX = "{http://www.asam.net/xml/fbx}"
_FLEXRAY = "{http://www.asam.net/xml/fbx/flexray}"
_HO = "{http://www.asam.net/xml}"


class FibexError(ClusterError):
    """A FIBEX file that does not describe one valid FlexRay cluster; names the element."""


class _Tag(NamedTuple):
    """A FIBEX element of the FlexRay name space, and the field of a cluster that it holds."""

    name: str
    field: str
    kind: type[int] | type[float] = int


_CLUSTER_TAGS = (
    _Tag("ACTION-POINT-OFFSET", "action_point_macroticks"),
    _Tag("DYNAMIC-SLOT-IDLE-PHASE", "dynamic_slot_idle_phase_minislots"),
    _Tag("MINISLOT", "minislot_macroticks"),
    _Tag("MINISLOT-ACTION-POINT-OFFSET", "minislot_action_point_macroticks"),
    _Tag("N-I-T", "network_idle_time_macroticks"),
    _Tag("STATIC-SLOT", "static_slot_macroticks"),
    _Tag("SYMBOL-WINDOW", "symbol_window_macroticks"),
    _Tag("T-S-S-TRANSMITTER", "transmission_start_bits"),
    _Tag("MACRO-PER-CYCLE", "macroticks_per_cycle"),
    _Tag("MACROTICK", "macrotick_us", float),
    _Tag("NUMBER-OF-MINISLOTS", "minislots"),
    _Tag("NUMBER-OF-STATIC-SLOTS", "static_slots"),
    _Tag("PAYLOAD-LENGTH-STATIC", "static_payload_words"),
    _Tag("CYCLE", "cycle_us", float),
)
_CLOCK_TAGS = (
    _Tag("COLD-START-ATTEMPTS", "cold_start_attempts"),
    _Tag("LISTEN-NOISE", "listen_noise"),
    _Tag("MAX-WITHOUT-CLOCK-CORRECTION-FATAL", "halt_after_cycle_pairs"),
    _Tag("MAX-WITHOUT-CLOCK-CORRECTION-PASSIVE", "passive_after_cycle_pairs"),
    _Tag("OFFSET-CORRECTION-START", "offset_correction_start_macroticks"),
    _Tag("SYNC-NODE-MAX", "sync_nodes_most"),
    _Tag("CLUSTER-DRIFT-DAMPING", "drift_damping_microticks"),
    _Tag("OFFSET-CORRECTION-MAX", "offset_correction_us", float),
)
_CONTROLLER_TAGS = (
    _Tag("MAX-DYNAMIC-PAYLOAD-LENGTH", "dynamic_payload_words"),
    _Tag("LATEST-TX", "latest_transmission_minislot"),
    _Tag("MICRO-PER-CYCLE", "microticks_per_cycle"),
    _Tag("MICROTICK", "microtick_us", float),
)
_CORRECTION_TAGS = (
    _Tag("ACCEPTED-STARTUP-RANGE", "startup_range_microticks"),
    _Tag("LISTEN-TIMEOUT", "listen_timeout_microticks"),
    _Tag("MAX-DRIFT", "drift_microticks"),
    _Tag("OFFSET-CORRECTION-OUT", "offset_correction_microticks"),
    _Tag("RATE-CORRECTION-OUT", "rate_correction_microticks"),
)
_ALL_TAGS = _CLUSTER_TAGS + _CLOCK_TAGS + _CONTROLLER_TAGS + _CORRECTION_TAGS
WITHOUT_ELEMENT = ("precision_us", "propagation_delay_us")
"""Fields of a cluster for which FIBEX has no element."""


def cluster_from_fibex(text: str | bytes, name: str | None = None) -> Cluster:
    """The FlexRay cluster of a FIBEX document; `name` chooses where there are several.

    A file without controllers leaves fields open; they get the usual values: microticks of 25 ns,
    the longest dynamic payload and the largest pLatestTx that the dynamic segment allows. The cycle
    counter runs to 63, as FlexRay 2.1 has it, unless CYCLE-COUNT-MAX says otherwise. Raises
    FibexError for a document that is not well-formed, declares a document type (entities can be
    made to fill the memory), or has missing or contradictory elements.
    """
    root = _parse(text)
    element = _flexray_cluster(root, name)
    title = _text(element, _HO, "SHORT-NAME", "cluster")
    where = f"cluster {title!r}"
    fields: dict[str, Any] = {
        "name": title,
        "channels": _channels(root, element, where),
        "bit_rate_mbps": _bit_rate_mbps(element, where),
        "number_of_cycles": 1 + _number(element, _FLEXRAY, "CYCLE-COUNT-MAX", int, where, 63),
        **{tag.field: _required(element, tag, where) for tag in _CLUSTER_TAGS},
        **{
            tag.field: _number(element, _FLEXRAY, tag.name, tag.kind, where, None)
            for tag in _CLOCK_TAGS
        },
    }
    period_us = _number(element, _FLEXRAY, "SAMPLE-CLOCK-PERIOD", float, where, 0.0)
    fields |= _controller_fields(_controllers(root, element), period_us)
    try:
        return _with_usual_values(fields)
    except ClusterError as error:
        tags = [tag.name for tag in _ALL_TAGS if tag.field in str(error)]
        raise FibexError(f"{error} (FIBEX elements: {', '.join(tags) or 'SHORT-NAME'})") from error


def cluster_to_fibex(cluster: Cluster) -> str:
    """The FIBEX document of a cluster, with one controller that has the nodes' parameters and one
    for each key slot. The fields in `WITHOUT_ELEMENT` are left out."""
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
{_lines(fields, _CLUSTER_TAGS + _CLOCK_TAGS)}
        <flexray:BIT>{cluster.bit_us!r}</flexray:BIT>
      </fx:CLUSTER>
    </fx:CLUSTERS>
    <fx:CHANNELS>
{channels}
    </fx:CHANNELS>
    <fx:ECUS><fx:ECU ID="ecu"><ho:SHORT-NAME>node</ho:SHORT-NAME><fx:CONTROLLERS>
      <fx:CONTROLLER ID="controller" xsi:type="flexray:CONTROLLER-TYPE">
        <ho:SHORT-NAME>controller</ho:SHORT-NAME>
{_lines(fields, _CONTROLLER_TAGS + _CORRECTION_TAGS)}
      </fx:CONTROLLER>{key_slots}
    </fx:CONTROLLERS></fx:ECU></fx:ECUS>
  </fx:ELEMENTS>
</fx:FIBEX>
"""


def _lines(fields: dict[str, Any], tags: Iterable[_Tag]) -> str:
    return "\n".join(
        f"        <flexray:{tag.name}>{fields[tag.field]!r}</flexray:{tag.name}>"
        for tag in tags
        if fields[tag.field] is not None
    )


class _NoDocumentType(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str, system: str) -> None:
        raise FibexError(
            f"the FIBEX file declares a document type ({name!r}), in which entities can be defined "
            "that fill the memory; remove the DOCTYPE declaration, FIBEX needs none"
        )


def _parse(text: str | bytes) -> Element:
    parser = ElementTree.XMLParser(target=_NoDocumentType())
    try:
        return ElementTree.fromstring(text, parser=parser)
    except (ElementTree.ParseError, LookupError, UnicodeError) as error:
        raise FibexError(f"the FIBEX file is not well-formed XML: {error}") from error


def _flexray_cluster(root: Element, name: str | None) -> Element:
    """The cluster with elements of the FlexRay name space (a file may describe CAN, too)."""
    clusters = {
        element.findtext(f"{_HO}SHORT-NAME", ""): element
        for element in root.iter(f"{_FX}CLUSTER")
        if any(child.tag.startswith(_FLEXRAY) for child in element)
    }
    if not clusters:
        raise FibexError(
            "the file has no <CLUSTER> of type flexray:CLUSTER-TYPE; export the FlexRay cluster"
        )
    if name is None and len(clusters) == 1:
        return next(iter(clusters.values()))
    if name not in clusters:
        wanted = "several <CLUSTER>s" if name is None else f"no <CLUSTER> {name!r}"
        raise FibexError(f"the file has {wanted}; choose one of {', '.join(map(repr, clusters))}")
    return clusters[name]


def _channels(root: Element, element: Element, where: str) -> str:
    names = {
        channel.get("ID"): channel.findtext(f"{_FLEXRAY}FLEXRAY-CHANNEL-NAME", "").strip()
        for channel in root.iter(f"{_FX}CHANNEL")
    }
    references = [reference.get("ID-REF") for reference in element.iter(f"{_FX}CHANNEL-REF")]
    lost = [reference for reference in references if names.get(reference) not in ("A", "B")]
    if not references or lost:
        raise FibexError(
            f"{where}: <CHANNEL-REF> {lost or 'is missing'}; it must refer to a <CHANNEL> with "
            "<FLEXRAY-CHANNEL-NAME> A or B"
        )
    return "".join(sorted({names[reference] for reference in references}))


def _bit_rate_mbps(element: Element, where: str) -> float:
    """From SPEED (bit/s) and BIT (us); one of them may be missing."""
    speed = _number(element, _FX, "SPEED", float, where, 0.0) / 1e6
    bit_us = _number(element, _FLEXRAY, "BIT", float, where, 0.0)
    if not speed and not bit_us:
        raise FibexError(f"{where}: <SPEED> and <BIT> are missing; add the bit rate in bit/s")
    if speed and bit_us and abs(speed * bit_us - 1.0) > 1e-6:
        raise FibexError(
            f"{where}: <SPEED> says {speed:g} Mbit/s, but <BIT> {bit_us:g} us; correct one of them"
        )
    return speed or round(1.0 / bit_us, 6)


def _controllers(root: Element, element: Element) -> list[Element]:
    """The controllers that connectors put on the cluster's channels; all where there are none."""
    channels = {reference.get("ID-REF") for reference in element.iter(f"{_FX}CHANNEL-REF")}
    connected: dict[str | None, bool] = {}
    for connector in root.iter(f"{_FX}CONNECTOR"):
        on = {reference.get("ID-REF") for reference in connector.iter(f"{_FX}CHANNEL-REF")}
        for reference in connector.iter(f"{_FX}CONTROLLER-REF"):
            name = reference.get("ID-REF")
            connected[name] = connected.get(name, False) or bool(on & channels)
    return [
        controller
        for controller in root.iter(f"{_FX}CONTROLLER")
        if connected.get(controller.get("ID"), not connected)
    ]


def _controller_fields(controllers: Sequence[Element], period_us: float) -> dict[str, Any]:
    """Return the controllers' values: the earliest pLatestTx, the longest payload, the widest
    correction of any, and all key slots.

    The microtick is that of the first controller that has one, or so many sample clock periods;
    controllers may differ in clocks.
    """
    payload, latest, count, microtick = (_stated(controllers, tag) for tag in _CONTROLLER_TAGS)
    samples = _stated(controllers, _Tag("SAMPLES-PER-MICROTICK", "microtick_us"))
    if samples and period_us and not microtick:
        microtick = [round(samples[0] * period_us, 9)]
    usages = [usage for one in controllers for usage in one.iter(f"{_FLEXRAY}KEY-SLOT-USAGE")]
    sync, startup = (
        sorted({_key_slot(slot) for usage in usages for slot in usage.findall(_FLEXRAY + name)})
        for name in ("SYNC", "STARTUP-SYNC")
    )
    found = {
        "dynamic_payload_words": max(payload, default=None),
        "latest_transmission_minislot": min(latest, default=None),
        "microticks_per_cycle": count[0] if count else None,
        "microtick_us": microtick[0] if microtick else None,
        "sync_slots": tuple(sorted({*sync, *startup})),
        "startup_slots": tuple(startup),
        **{tag.field: max(_stated(controllers, tag), default=None) for tag in _CORRECTION_TAGS},
    }
    return {field: value for field, value in found.items() if value is not None}


def _stated(controllers: Sequence[Element], tag: _Tag) -> list[Any]:
    values = [
        _number(controller, _FLEXRAY, tag.name, tag.kind, "controller", None)
        for controller in controllers
    ]
    return [value for value in values if value is not None]


def _key_slot(element: Element) -> int:
    text = (element.text or "").strip()
    if not text.isdecimal():
        raise FibexError(f"controller: <KEY-SLOT-USAGE> says {text[:40]!r}, but must be a slot")
    return int(text)


def _with_usual_values(fields: dict[str, Any]) -> Cluster:
    """A cluster of these fields; those of the controllers are filled in where they are missing."""
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


def _required(element: Element, tag: _Tag, where: str) -> int | float:
    value = _number(element, _FLEXRAY, tag.name, tag.kind, where, None)
    if value is None:
        raise FibexError(
            f"{where}: element <flexray:{tag.name}> ({tag.field}) is missing; add it to the "
            "<CLUSTER>"
        )
    return value


def _number(
    element: Element, space: str, name: str, kind: type[int] | type[float], where: str, default: Any
) -> Any:
    """The number in a child element, or the default where there is none."""
    texts = {(child.text or "").strip() for child in element.findall(f"{space}{name}")}
    if not texts:
        return default
    if len(texts) > 1:
        raise FibexError(
            f"{where}: element <{name}> is there several times with different values "
            f"({', '.join(sorted(texts))}); keep one"
        )
    (text,) = texts
    number = "a whole number" if kind is int else "a number"
    try:
        value = kind(text)
    except ValueError as error:
        raise FibexError(f"{where}: <{name}> says {text[:40]!r}, but must be {number}") from error
    if not abs(value) < 1e9:
        raise FibexError(
            f"{where}: <{name}> says {text[:40]!r}, but must be a sensible {number[2:]}"
        )
    return value


def _text(element: Element, space: str, name: str, where: str) -> str:
    text = element.findtext(f"{space}{name}", "")
    if not text.strip():
        raise FibexError(f"{where}: element <{name}> is missing; give the {where} a name")
    return text
