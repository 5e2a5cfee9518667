"""Clusters in FIBEX, the exchange format of FlexRay tools (ASAM MCD-2 NET, versions 2 to 4).

Reads a cluster, its channels and, where a file has them, the controllers on these channels
(pLatestTx, microtick, longest dynamic payload, corrections, key slots). Wake-up is left alone.
"""

from collections.abc import Sequence
from typing import Any

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.features.flexray_tools.files.usual_values import with_usual_values
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    Element,
    Tag,
    bit_rate_mbps,
    chosen_cluster,
    missing_elements,
    number,
    parse_document,
)

FX = "{http://www.asam.net/xml/fbx}"
FLEXRAY = "{http://www.asam.net/xml/fbx/flexray}"
HO = "{http://www.asam.net/xml}"


CLUSTER_TAGS = (
    Tag("ACTION-POINT-OFFSET", "action_point_macroticks"),
    Tag("DYNAMIC-SLOT-IDLE-PHASE", "dynamic_slot_idle_phase_minislots"),
    Tag("MINISLOT", "minislot_macroticks"),
    Tag("MINISLOT-ACTION-POINT-OFFSET", "minislot_action_point_macroticks"),
    Tag("N-I-T", "network_idle_time_macroticks"),
    Tag("STATIC-SLOT", "static_slot_macroticks"),
    Tag("SYMBOL-WINDOW", "symbol_window_macroticks"),
    Tag("T-S-S-TRANSMITTER", "transmission_start_bits"),
    Tag("MACRO-PER-CYCLE", "macroticks_per_cycle"),
    Tag("MACROTICK", "macrotick_us", float),
    Tag("NUMBER-OF-MINISLOTS", "minislots"),
    Tag("NUMBER-OF-STATIC-SLOTS", "static_slots"),
    Tag("PAYLOAD-LENGTH-STATIC", "static_payload_words"),
    Tag("CYCLE", "cycle_us", float),
)
CLOCK_TAGS = (
    Tag("COLD-START-ATTEMPTS", "cold_start_attempts"),
    Tag("LISTEN-NOISE", "listen_noise"),
    Tag("MAX-WITHOUT-CLOCK-CORRECTION-FATAL", "halt_after_cycle_pairs"),
    Tag("MAX-WITHOUT-CLOCK-CORRECTION-PASSIVE", "passive_after_cycle_pairs"),
    Tag("OFFSET-CORRECTION-START", "offset_correction_start_macroticks"),
    Tag("SYNC-NODE-MAX", "sync_nodes_most"),
    Tag("CLUSTER-DRIFT-DAMPING", "drift_damping_microticks"),
    Tag("OFFSET-CORRECTION-MAX", "offset_correction_us", float),
)
CONTROLLER_TAGS = (
    Tag("MAX-DYNAMIC-PAYLOAD-LENGTH", "dynamic_payload_words"),
    Tag("LATEST-TX", "latest_transmission_minislot"),
    Tag("MICRO-PER-CYCLE", "microticks_per_cycle"),
    Tag("MICROTICK", "microtick_us", float),
)
CORRECTION_TAGS = (
    Tag("ACCEPTED-STARTUP-RANGE", "startup_range_microticks"),
    Tag("LISTEN-TIMEOUT", "listen_timeout_microticks"),
    Tag("MAX-DRIFT", "drift_microticks"),
    Tag("OFFSET-CORRECTION-OUT", "offset_correction_microticks"),
    Tag("RATE-CORRECTION-OUT", "rate_correction_microticks"),
)
ALL_TAGS = CLUSTER_TAGS + CLOCK_TAGS + CONTROLLER_TAGS + CORRECTION_TAGS
WITHOUT_ELEMENT = ("precision_us", "propagation_delay_us")
"""Fields of a cluster for which FIBEX has no element."""


def cluster_from_fibex(text: str | bytes, name: str | None = None) -> Cluster:
    """Return the FlexRay cluster of a FIBEX document; `name` chooses where there are several.

    A file without controllers leaves fields open; they get the usual values: microticks of 25 ns,
    the longest dynamic payload and the largest pLatestTx that the dynamic segment allows. The cycle
    counter runs to 63, as FlexRay 2.1 has it, unless CYCLE-COUNT-MAX says otherwise.

    Raises:
        ClusterFileError: the document is not well-formed, declares a document type, or has missing
            or contradictory elements.
    """
    root = parse_document(text, "FIBEX").root
    element = flexray_cluster(root, name)
    title = text_of(element, HO, "SHORT-NAME", "cluster")
    where = f"cluster {title!r}"
    _check_complete(element, where)
    stated = {
        tag.field: number(element, FLEXRAY + tag.name, tag.kind, where)
        for tag in CLUSTER_TAGS + CLOCK_TAGS
    }
    count = number(element, f"{FLEXRAY}CYCLE-COUNT-MAX", int, where)
    rate, bit_us = (number(element, t, float, where) for t in (f"{FX}SPEED", f"{FLEXRAY}BIT"))
    fields: dict[str, Any] = {
        "name": title,
        "channels": _channels(root, element, where),
        "bit_rate_mbps": bit_rate_mbps(rate, bit_us, "SPEED", where),
        "number_of_cycles": 64 if count is None else 1 + count,
        **stated,
    }
    period_us = number(element, f"{FLEXRAY}SAMPLE-CLOCK-PERIOD", float, where) or 0.0
    fields |= _controller_fields(_controllers(root, element), period_us)
    try:
        return with_usual_values(fields)
    except ClusterError as error:
        tags = [tag.name for tag in ALL_TAGS if tag.field in str(error)]
        raise ClusterFileError(
            f"{error} (FIBEX elements: {', '.join(tags) or 'SHORT-NAME'})"
        ) from error


def channels_of(root: Element, element: Element) -> list[tuple[Element, str]]:
    """Return the channels of a cluster, each with its letter."""
    references = {reference.get("ID-REF") for reference in element.iter(f"{FX}CHANNEL-REF")}
    return [
        (channel, channel.findtext(f"{FLEXRAY}FLEXRAY-CHANNEL-NAME", "").strip())
        for channel in root.iter(f"{FX}CHANNEL")
        if channel.get("ID") in references
    ]


def flexray_cluster(root: Element, name: str | None) -> Element:
    """Return the cluster with elements of the FlexRay name space (a file may describe CAN, too).

    Raises:
        ClusterFileError: there is none, or several and no name.
    """
    clusters = {
        element.findtext(f"{HO}SHORT-NAME", ""): element
        for element in root.iter(f"{FX}CLUSTER")
        if any(str(child.tag).startswith(FLEXRAY) for child in element)
    }
    cure = "<CLUSTER> of type flexray:CLUSTER-TYPE; export the FlexRay cluster"
    return chosen_cluster(clusters, name, "CLUSTER", cure)


def _channels(root: Element, element: Element, where: str) -> str:
    names = {
        channel.get("ID"): channel.findtext(f"{FLEXRAY}FLEXRAY-CHANNEL-NAME", "").strip()
        for channel in root.iter(f"{FX}CHANNEL")
    }
    references = [reference.get("ID-REF") for reference in element.iter(f"{FX}CHANNEL-REF")]
    lost = [reference for reference in references if names.get(reference) not in ("A", "B")]
    if not references or lost:
        raise ClusterFileError(
            f"{where}: <CHANNEL-REF> {lost or 'is missing'}; it must refer to a <CHANNEL> with "
            "<FLEXRAY-CHANNEL-NAME> A or B"
        )
    return "".join(sorted({names[reference] for reference in references}))


def _controllers(root: Element, element: Element) -> list[Element]:
    """The controllers that connectors put on the cluster's channels; all where there are none."""
    channels = {reference.get("ID-REF") for reference in element.iter(f"{FX}CHANNEL-REF")}
    connected: dict[str | None, bool] = {}
    for connector in root.iter(f"{FX}CONNECTOR"):
        on = {reference.get("ID-REF") for reference in connector.iter(f"{FX}CHANNEL-REF")}
        for reference in connector.iter(f"{FX}CONTROLLER-REF"):
            name = reference.get("ID-REF")
            connected[name] = connected.get(name, False) or bool(on & channels)
    return [
        controller
        for controller in root.iter(f"{FX}CONTROLLER")
        if connected.get(controller.get("ID"), not connected)
    ]


def _controller_fields(controllers: Sequence[Element], period_us: float) -> dict[str, Any]:
    """Return the controllers' values: the earliest pLatestTx, the longest payload, the widest
    correction of any, and all key slots.

    The microtick is that of the first controller that has one, or so many sample clock periods;
    controllers may differ in clocks.
    """
    payload, latest, count, microtick = (_stated(controllers, tag) for tag in CONTROLLER_TAGS)
    samples = _stated(controllers, Tag("SAMPLES-PER-MICROTICK", "microtick_us"))
    if samples and period_us and not microtick:
        microtick = [round(samples[0] * period_us, 9)]
    usages = [usage for one in controllers for usage in one.iter(f"{FLEXRAY}KEY-SLOT-USAGE")]
    sync, startup = (
        sorted({_key_slot(slot) for usage in usages for slot in usage.findall(FLEXRAY + name)})
        for name in ("SYNC", "STARTUP-SYNC")
    )
    found = {
        "dynamic_payload_words": max(payload, default=None),
        "latest_transmission_minislot": min(latest, default=None),
        "microticks_per_cycle": count[0] if count else None,
        "microtick_us": microtick[0] if microtick else None,
        "sync_slots": tuple(sorted({*sync, *startup})),
        "startup_slots": tuple(startup),
        **{tag.field: max(_stated(controllers, tag), default=None) for tag in CORRECTION_TAGS},
    }
    return {field: value for field, value in found.items() if value is not None}


def _stated(controllers: Sequence[Element], tag: Tag) -> list[Any]:
    values = [
        number(controller, FLEXRAY + tag.name, tag.kind, "controller") for controller in controllers
    ]
    return [value for value in values if value is not None]


def _key_slot(element: Element) -> int:
    text = (element.text or "").strip()
    if not text.isdecimal():
        raise ClusterFileError(
            f"controller: <KEY-SLOT-USAGE> says {text[:40]!r}, but must be a slot"
        )
    return int(text)


def _check_complete(element: Element, where: str) -> None:
    """Refuse a cluster that lacks elements, with all their names."""
    missing = [
        f"<flexray:{tag.name}> ({tag.field})"
        for tag in CLUSTER_TAGS
        if element.find(FLEXRAY + tag.name) is None
    ]
    if next(element.iter(f"{FX}CHANNEL-REF"), None) is None:
        missing.append("<CHANNEL-REF> (to a <CHANNEL> with <FLEXRAY-CHANNEL-NAME> A or B)")
    if element.find(f"{FX}SPEED") is None and element.find(f"{FLEXRAY}BIT") is None:
        missing.append("<SPEED> and <BIT> (the bit rate)")
    if missing:
        raise missing_elements(where, missing, "CLUSTER")


def text_of(element: Element, space: str, name: str, where: str) -> str:
    """Return the text of a child element.

    Raises:
        ClusterFileError: it is missing or empty.
    """
    text = element.findtext(f"{space}{name}", "")
    if not text.strip():
        raise ClusterFileError(f"{where}: element <{name}> is missing; give the {where} a name")
    return text
