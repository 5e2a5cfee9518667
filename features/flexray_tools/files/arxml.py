"""Clusters in AUTOSAR's exchange format (ARXML, classic platform, schema 4).

Reads a FLEXRAY-CLUSTER and the FLEXRAY-COMMUNICATION-CONTROLLERs whose connectors are on its
channels. Times are printed in seconds there. Variants, signals and wake-up are left alone.
"""

import re
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
    microseconds,
    missing_elements,
    number,
    parse_document,
)

AR = "{http://autosar.org/schema/r4.0}"


CLUSTER_TAGS = (
    Tag("ACTION-POINT-OFFSET", "action_point_macroticks"),
    Tag("CYCLE", "cycle_us", float),
    Tag("DYNAMIC-SLOT-IDLE-PHASE", "dynamic_slot_idle_phase_minislots"),
    Tag("MACRO-PER-CYCLE", "macroticks_per_cycle"),
    Tag("MACROTICK-DURATION", "macrotick_us", float),
    Tag("MINISLOT-ACTION-POINT-OFFSET", "minislot_action_point_macroticks"),
    Tag("MINISLOT-DURATION", "minislot_macroticks"),
    Tag("NETWORK-IDLE-TIME", "network_idle_time_macroticks"),
    Tag("NUMBER-OF-MINISLOTS", "minislots"),
    Tag("NUMBER-OF-STATIC-SLOTS", "static_slots"),
    Tag("PAYLOAD-LENGTH-STATIC", "static_payload_words"),
    Tag("STATIC-SLOT-DURATION", "static_slot_macroticks"),
    Tag("SYMBOL-WINDOW", "symbol_window_macroticks"),
    Tag("TRANSMISSION-START-SEQUENCE-DURATION", "transmission_start_bits"),
)
CLOCK_TAGS = (
    Tag("COLD-START-ATTEMPTS", "cold_start_attempts"),
    Tag("LISTEN-NOISE", "listen_noise"),
    Tag("MAX-WITHOUT-CLOCK-CORRECTION-FATAL", "halt_after_cycle_pairs"),
    Tag("MAX-WITHOUT-CLOCK-CORRECTION-PASSIVE", "passive_after_cycle_pairs"),
    Tag("OFFSET-CORRECTION-START", "offset_correction_start_macroticks"),
    Tag("SYNC-FRAME-ID-COUNT-MAX", "sync_nodes_most"),
)
CONTROLLER_TAGS = (
    Tag("ACCEPTED-STARTUP-RANGE", "startup_range_microticks"),
    Tag("CLUSTER-DRIFT-DAMPING", "drift_damping_microticks"),
    Tag("LATEST-TX", "latest_transmission_minislot"),
    Tag("LISTEN-TIMEOUT", "listen_timeout_microticks"),
    Tag("MAXIMUM-DYNAMIC-PAYLOAD-LENGTH", "dynamic_payload_words"),
    Tag("MICRO-PER-CYCLE", "microticks_per_cycle"),
    Tag("MICROTICK-DURATION", "microtick_us", float),
    Tag("OFFSET-CORRECTION-OUT", "offset_correction_microticks"),
    Tag("RATE-CORRECTION-OUT", "rate_correction_microticks"),
)
WITHOUT_ELEMENT = (
    "precision_us", "propagation_delay_us", "offset_correction_us", "drift_microticks"
)  # fmt: skip
"""Fields of a cluster for which AUTOSAR has no element."""
# Nodes of a cluster share these; of the others the widest counts.
_EARLIEST = ("latest_transmission_minislot",)
_FIRST = ("microticks_per_cycle", "microtick_us")


def cluster_from_arxml(text: str | bytes, name: str | None = None) -> Cluster:
    """Return the FlexRay cluster of an ARXML document; `name` chooses where there are several.

    A file without controllers leaves fields open, which get the usual values as in FIBEX.

    Raises:
        ClusterFileError: the document is not well-formed, declares a document type, or has missing
            or contradictory elements.
    """
    root = parse_document(text, "ARXML").root
    cluster = flexray_cluster(root, name)
    title = _title(cluster)
    where = f"cluster {title!r}"
    values = conditional(cluster, "FLEXRAY-CLUSTER")
    _check_complete(values, where)
    count = number(values, f"{AR}CYCLE-COUNT-MAX", int, where)
    rate, bit_s = (number(values, AR + tag, float, where) for tag in ("BAUDRATE", "BIT"))
    fields: dict[str, Any] = {
        "name": title,
        "channels": "".join(sorted(letter for _, letter in channels_of(cluster, where))),
        "bit_rate_mbps": bit_rate_mbps(rate, microseconds(bit_s or 0.0), "BAUDRATE", where),
        "number_of_cycles": 64 if count is None else 1 + count,
        **{tag.field: _value(values, tag, where) for tag in CLUSTER_TAGS + CLOCK_TAGS},
    }
    period_s = number(values, f"{AR}SAMPLE-CLOCK-PERIOD", float, where) or 0.0
    fields |= _controller_fields(_controllers(root, cluster, where), period_s)
    try:
        return with_usual_values(fields)
    except ClusterError as error:
        tags = [tag.name for tag in CLUSTER_TAGS + CLOCK_TAGS if tag.field in str(error)]
        tags += [tag.name for tag in CONTROLLER_TAGS if tag.field in str(error)]
        names = ", ".join(tags) or "SHORT-NAME"
        raise ClusterFileError(f"{error} (AUTOSAR elements: {names})") from error


def flexray_cluster(root: Element, name: str | None) -> Element:
    """Return the FLEXRAY-CLUSTER of a document.

    Raises:
        ClusterFileError: there is none, or several and no name.
    """
    clusters = {_title(one): one for one in root.iter(f"{AR}FLEXRAY-CLUSTER")}
    cure = (
        "<FLEXRAY-CLUSTER> of the name space http://autosar.org/schema/r4.0; export the system "
        "with its FlexRay cluster"
    )
    return chosen_cluster(clusters, name, "FLEXRAY-CLUSTER", cure)


def short_name(element: Element) -> str:
    """Return the SHORT-NAME of an element.

    Raises:
        ClusterFileError: it is missing or empty.
    """
    text = element.findtext(f"{AR}SHORT-NAME", "").strip()
    if not text:
        kind = element.tag.rpartition("}")[2]
        raise ClusterFileError(f"<{kind}>: element <SHORT-NAME> is missing; give it a name")
    return text


def identifier(name: str) -> str:
    """Return the SHORT-NAME for a name: letters, digits and underscores, 128 at most."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:127]
    return plain if plain[:1].isalpha() else f"c{plain}"


def _title(cluster: Element) -> str:
    """Return the name of a cluster: its LONG-NAME, where the SHORT-NAME cannot spell it."""
    name = short_name(cluster)
    long = cluster.findtext(f"{AR}LONG-NAME/{AR}L-4", "")
    return long if identifier(long) == name else name


def conditional(element: Element, kind: str) -> Element:
    """Return the element with the values of a cluster or controller: its only variant, or itself.

    Raises:
        ClusterFileError: it has several variants.
    """
    variants = element.findall(f"{AR}{kind}-VARIANTS/{AR}{kind}-CONDITIONAL")
    if len(variants) > 1:
        raise ClusterFileError(
            f"<{kind}> {short_name(element)!r}: it has {len(variants)} variants; export one of them"
        )
    return variants[0] if variants else element


def channels_of(cluster: Element, where: str) -> list[tuple[Element, str]]:
    """Return the physical channels of a cluster, each with its letter.

    Raises:
        ClusterFileError: there is none, or one is neither A nor B.
    """
    found: list[tuple[Element, str]] = []
    for channel in cluster.iter(f"{AR}FLEXRAY-PHYSICAL-CHANNEL"):
        letter = channel.findtext(f"{AR}CHANNEL-NAME", "").strip().removeprefix("CHANNEL-")
        if letter not in ("A", "B"):
            raise ClusterFileError(
                f"{where}: channel {short_name(channel)!r} has <CHANNEL-NAME> {letter!r}; it must "
                "be CHANNEL-A or CHANNEL-B"
            )
        found.append((channel, letter))
    return found


def _check_complete(values: Element, where: str) -> None:
    missing = [
        f"<{tag.name}> ({tag.field})" for tag in CLUSTER_TAGS if values.find(AR + tag.name) is None
    ]
    if next(values.iter(f"{AR}FLEXRAY-PHYSICAL-CHANNEL"), None) is None:
        missing.append("<FLEXRAY-PHYSICAL-CHANNEL> (with <CHANNEL-NAME> CHANNEL-A or CHANNEL-B)")
    if values.find(f"{AR}BAUDRATE") is None and values.find(f"{AR}BIT") is None:
        missing.append("<BAUDRATE> or <BIT> (the bit rate)")
    if missing:
        raise missing_elements(where, missing, "FLEXRAY-CLUSTER-CONDITIONAL")


def _value(element: Element, tag: Tag, where: str) -> Any:
    found = number(element, AR + tag.name, tag.kind, where)
    return microseconds(found) if found is not None and tag.kind is float else found


def paths_of(root: Element) -> dict[str, Element]:
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
    named = paths_of(root)
    connected = []
    for channel, _ in channels_of(cluster, where):
        for reference in channel.iter(f"{AR}COMMUNICATION-CONNECTOR-REF"):
            connector = named.get((reference.text or "").strip())
            if connector is not None:
                path = connector.findtext(f"{AR}COMM-CONTROLLER-REF", "").strip()
                connected += [named[path]] if path in named else []
    every = list(root.iter(f"{AR}FLEXRAY-COMMUNICATION-CONTROLLER"))
    kept = [one for one in every if one in connected or not connected]
    return [conditional(one, "FLEXRAY-COMMUNICATION-CONTROLLER") for one in kept]


def _controller_fields(controllers: Sequence[Element], period_s: float) -> dict[str, Any]:
    """Return the controllers' values as those of FIBEX: the earliest, the first or the widest."""
    found: dict[str, Any] = {}
    for tag in CONTROLLER_TAGS:
        stated = [_value(one, tag, "controller") for one in controllers]
        values = [value for value in stated if value is not None]
        if values:
            first = values[0] if tag.field in _FIRST else max(values)
            found[tag.field] = min(values) if tag.field in _EARLIEST else first
    samples = [number(one, f"{AR}SAMPLES-PER-MICROTICK", int, "controller") for one in controllers]
    if "microtick_us" not in found and samples[:1] not in ([], [None]) and period_s:
        found["microtick_us"] = round(microseconds(period_s) * samples[0], 9)
    sync = _key_slots(controllers, "KEY-SLOT-USED-FOR-SYNC")
    startup = _key_slots(controllers, "KEY-SLOT-USED-FOR-START-UP")
    found["sync_slots"] = tuple(sorted({*sync, *startup}))
    found["startup_slots"] = tuple(startup)
    return found


def _key_slots(controllers: Sequence[Element], usage: str) -> list[int]:
    slots = {
        number(one, f"{AR}KEY-SLOT-ID", int, "controller")
        for one in controllers
        if one.findtext(AR + usage, "").strip().lower() in ("true", "1")
    }
    if None in slots:
        raise ClusterFileError(f"controller: <{usage}> is true, but <KEY-SLOT-ID> is missing")
    return sorted(slots)
