"""Clusters and slot tables of FIBEX and AUTOSAR: one table of parameters, read and written alike.

`fibex.py` and `arxml.py` say where the elements of their format stand.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import Any, NamedTuple, cast

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.features.flexray_tools.files.usual_values import (
    ESSENTIAL,
    NAMED_USUAL,
    OF_CONTROLLERS,
    usual_values,
    with_usual_controllers,
)
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    Element,
    number,
    parse_document,
)

SLOT_FIELDS_WITHOUT_ELEMENT = ("period_us", "offset_us", "deadline_us")
"""Fields of a slot for which a frame triggering has no element."""
MAX_MINISLOTS = 7988
_NODE = re.compile(r"node_(\d+)")


class Exchanged(NamedTuple):
    """A field of a cluster, and the element that holds it in each format.

    Attributes:
        fibex, arxml: names of the element, "" where the format has none; None: as in FIBEX.
        kind: times are float, in microseconds; FIBEX has these too, AUTOSAR has seconds.
        part: cluster (each file has it), clocks (of the cluster, may be missing) or controller.
        of_several: chooses from the values of controllers that differ.
    """

    field: str
    fibex: str
    arxml: str | None = None
    kind: type[int] | type[float] = int
    part: str = "cluster"
    of_several: Callable[[list[Any]], Any] = max


_CLOCKS, _NODE_PART = "clocks", "controller"
PARAMETERS = (
    Exchanged("action_point_macroticks", "ACTION-POINT-OFFSET"),
    Exchanged("dynamic_slot_idle_phase_minislots", "DYNAMIC-SLOT-IDLE-PHASE"),
    Exchanged("minislot_macroticks", "MINISLOT", "MINISLOT-DURATION"),
    Exchanged("minislot_action_point_macroticks", "MINISLOT-ACTION-POINT-OFFSET"),
    Exchanged("network_idle_time_macroticks", "N-I-T", "NETWORK-IDLE-TIME"),
    Exchanged("static_slot_macroticks", "STATIC-SLOT", "STATIC-SLOT-DURATION"),
    Exchanged("symbol_window_macroticks", "SYMBOL-WINDOW"),
    Exchanged(
        "transmission_start_bits", "T-S-S-TRANSMITTER", "TRANSMISSION-START-SEQUENCE-DURATION"
    ),
    Exchanged("macroticks_per_cycle", "MACRO-PER-CYCLE"),
    Exchanged("macrotick_us", "MACROTICK", "MACROTICK-DURATION", float),
    Exchanged("minislots", "NUMBER-OF-MINISLOTS"),
    Exchanged("static_slots", "NUMBER-OF-STATIC-SLOTS"),
    Exchanged("static_payload_words", "PAYLOAD-LENGTH-STATIC"),
    Exchanged("cycle_us", "CYCLE", kind=float),
    Exchanged("cold_start_attempts", "COLD-START-ATTEMPTS", part=_CLOCKS),
    Exchanged("listen_noise", "LISTEN-NOISE", part=_CLOCKS),
    Exchanged("halt_after_cycle_pairs", "MAX-WITHOUT-CLOCK-CORRECTION-FATAL", part=_CLOCKS),
    Exchanged("passive_after_cycle_pairs", "MAX-WITHOUT-CLOCK-CORRECTION-PASSIVE", part=_CLOCKS),
    Exchanged("offset_correction_start_macroticks", "OFFSET-CORRECTION-START", part=_CLOCKS),
    Exchanged("sync_nodes_most", "SYNC-NODE-MAX", "SYNC-FRAME-ID-COUNT-MAX", part=_CLOCKS),
    Exchanged("drift_damping_microticks", "CLUSTER-DRIFT-DAMPING", "", part=_CLOCKS),
    Exchanged("precision_us", "", "", float, _CLOCKS),
    Exchanged("propagation_delay_us", "", "", float, _CLOCKS),
    Exchanged("offset_correction_us", "OFFSET-CORRECTION-MAX", "", float, _CLOCKS),
    Exchanged("dynamic_payload_words", "MAX-DYNAMIC-PAYLOAD-LENGTH",
              "MAXIMUM-DYNAMIC-PAYLOAD-LENGTH", part=_NODE_PART),
    Exchanged("latest_transmission_minislot", "LATEST-TX", part=_NODE_PART, of_several=min),
    Exchanged("microticks_per_cycle", "MICRO-PER-CYCLE", part=_NODE_PART,
              of_several=itemgetter(0)),
    Exchanged("microtick_us", "MICROTICK", "MICROTICK-DURATION", float, _NODE_PART, itemgetter(0)),
    Exchanged("startup_range_microticks", "ACCEPTED-STARTUP-RANGE", part=_NODE_PART),
    Exchanged("drift_damping_microticks", "", "CLUSTER-DRIFT-DAMPING", part=_NODE_PART),
    Exchanged("listen_timeout_microticks", "LISTEN-TIMEOUT", part=_NODE_PART),
    Exchanged("drift_microticks", "MAX-DRIFT", "", part=_NODE_PART),
    Exchanged("offset_correction_microticks", "OFFSET-CORRECTION-OUT", part=_NODE_PART),
    Exchanged("rate_correction_microticks", "RATE-CORRECTION-OUT", part=_NODE_PART),
)  # fmt: skip


FoundFrame = tuple[str, str | None, int | None, str, Element | None]
"""Place in messages, name, length in bytes, sender and the sender's controller."""


class Format(NamedTuple):
    """An exchange format: its words, and the functions that find its elements.

    Attributes:
        name, standard: of its files and of its elements, in messages.
        space: name space of the parameters; messages write `prefix` for it.
        in_fibex: which names of `PARAMETERS` are its own.
        time_us, time_text: a time in microseconds from and to the number that is printed.
        rate: the element of the bit rate. length: that of the payload of a frame.
        cluster: the element of a cluster, and what the file should hold, for messages.
        parent: the element that the parameters stand in, for messages.
        no_channel, no_rate: what a cluster lacks without channels, or without a bit rate.
        triggering, timing: the elements of a frame triggering, and of its slot and cycle.
        clusters: (root) -> the clusters by name.
        title: (cluster) -> its name.
        values: (cluster) -> the element of its parameters.
        letters: (root, cluster, place in messages) -> the letters of its channels.
        channels: (root, cluster) -> channels with their letters.
        controllers: (root, cluster, place in messages) -> those on its channels.
        key_slots: (controllers) -> slots of sync frames, and of start-up frames.
        frames: (root) -> a function of a triggering: its place in messages, its frame, the length
            of this, the ECU that sends it ("" if none is known), and the controller of that.
        turn: (timing, cycles of the counter, place in messages) -> slot, base cycle, repetition.
        ecu_names: (root) -> names of all ECUs in order.
    """

    name: str
    standard: str
    space: str
    prefix: str
    in_fibex: bool
    time_us: Callable[[float], float]
    time_text: Callable[[float], str]
    rate: str
    length: str
    cluster: tuple[str, str]
    parent: str
    no_channel: tuple[str, str]
    no_rate: str
    triggering: str
    timing: str
    clusters: Callable[[Element], dict[str, Element]]
    title: Callable[[Element], str]
    values: Callable[[Element], Element]
    letters: Callable[[Element, Element, str], str]
    channels: Callable[[Element, Element], list[tuple[Element, str]]]
    controllers: Callable[[Element, Element, str], list[Element]]
    key_slots: Callable[[Sequence[Element]], tuple[list[int], list[int]]]
    frames: Callable[[Element], Callable[[Element], FoundFrame]]
    turn: Callable[[Element, int, str], tuple[int | None, int | None, int]]
    ecu_names: Callable[[Element], list[str]]

    def tags(self, *parts: str) -> dict[str, Exchanged]:
        """Return the parameters of these parts that the format has, by the names of elements."""
        rows: dict[str, Exchanged] = {}
        for part in parts:
            own = [(self._tag(row), row) for row in PARAMETERS if row.part == part]
            # The schema of AUTOSAR sorts its elements by name.
            rows |= {tag: row for tag, row in (own if self.in_fibex else sorted(own)) if tag}
        return rows

    def _tag(self, row: Exchanged) -> str:
        return row.fibex if self.in_fibex or row.arxml is None else row.arxml

    def lacking(self) -> tuple[str, ...]:
        """Return the fields of a cluster for which the format has no element."""
        held = {row.field for row in self.tags("cluster", _CLOCKS, _NODE_PART).values()}
        return tuple(row.field for row in PARAMETERS if row.field not in held)

    def read(self, element: Element, tag: str, kind: type, where: str) -> Any:
        """Return the number of an element, times in microseconds; None where it is missing."""
        found = number(element, self.space + tag, kind, where)
        return self.time_us(found) if found is not None and kind is float else found

    def stated(self, cluster: Cluster, *parts: str) -> Iterator[tuple[str, str]]:
        """Yield the elements of the parameters that a cluster states, and their texts."""
        for tag, row in self.tags(*parts).items():
            value = getattr(cluster, row.field)
            if value is not None:
                yield tag, self.time_text(value) if row.kind is float else str(value)


def find_cluster(form: Format, root: Element, name: str | None) -> Element:
    """Return the FlexRay cluster of a name, or the only one.

    Raises:
        ClusterFileError: there is none, or several and no name.
    """
    clusters = form.clusters(root)
    tag, cure = form.cluster
    if not clusters:
        raise ClusterFileError(f"the file has no {cure}")
    if name is None and len(clusters) == 1:
        return next(iter(clusters.values()))
    if name not in clusters:
        wanted = f"several <{tag}>s" if name is None else f"no <{tag}> {name!r}"
        names = ", ".join(map(repr, clusters))
        raise ClusterFileError(f"the file has {wanted}; choose one of {names}")
    return clusters[name]


class ReadCluster(NamedTuple):
    """A cluster of a file, and a line for each value that the file leaves open."""

    cluster: Cluster
    notes: tuple[str, ...]


def read_cluster(form: Format, text: str | bytes, name: str | None = None) -> ReadCluster:
    """Return the FlexRay cluster of a document; `name` chooses where there are several.

    Elements that a thin export lacks get the usual values (`usual_values`), and a line each. So do
    a file without controllers, and one whose cluster refers to no channel. The cycle counter runs
    to 63, as FlexRay 2.1 has it, unless CYCLE-COUNT-MAX says otherwise.

    Raises:
        ClusterFileError: the document is not well-formed, declares a document type, or has missing
            or contradictory elements.
    """
    root = parse_document(text, form.name).root
    element = find_cluster(form, root, name)
    title = form.title(element)
    where = f"cluster {title!r}"
    values = form.values(element)
    count = form.read(values, "CYCLE-COUNT-MAX", int, where)
    rate = number(values, form.rate, float, where)
    fields: dict[str, Any] = {
        "name": title,
        "channels": form.letters(root, element, where) or None,
        "bit_rate_mbps": _bit_rate_mbps(rate, form.read(values, "BIT", float, where), form, where),
        "number_of_cycles": 64 if count is None else 1 + count,
    }
    rows = form.tags("cluster", _CLOCKS)
    for tag, row in rows.items():
        fields[row.field] = form.read(values, tag, row.kind, where)
    _check_complete(form, fields, where)
    period_us = form.read(values, "SAMPLE-CLOCK-PERIOD", float, where)
    controllers, differing = _controller_fields(
        form, form.controllers(root, element, where), period_us
    )
    lacking = [field for field in NAMED_USUAL if fields[field] is None]
    if fields["minislots"]:
        lacking += [field for field in OF_CONTROLLERS if field not in controllers]
    try:
        usual = usual_values(fields)
        cluster = with_usual_controllers({**fields, **usual, **controllers})
    except ClusterError as error:
        rows = form.tags("cluster", _CLOCKS, _NODE_PART)
        tags = ", ".join(tag for tag, row in rows.items() if row.field in str(error))
        raise ClusterFileError(
            f"{error} ({form.standard} elements: {tags or 'SHORT-NAME'})"
        ) from error
    rows = form.tags("cluster", _NODE_PART)
    names = {row.field: f"<{tag}>" for tag, row in rows.items()}
    names |= {"channels": form.no_channel[1], "bit_rate_mbps": form.no_rate}
    notes = [
        f"{where}: {names[field]} is missing; {field} is taken to be {getattr(cluster, field)}"
        for field in lacking
    ]
    return ReadCluster(cluster, (*notes, *(f"{where}: {one}" for one in differing)))


def _check_complete(form: Format, fields: dict[str, Any], where: str) -> None:
    """Refuse a cluster that lacks elements without a usual value, with all their names."""
    rows = form.tags("cluster")
    known = sum(fields[field] is not None for field in ("macrotick_us", "macroticks_per_cycle"))
    missing = [
        f"<{form.prefix}{tag}> ({row.field})"
        for tag, row in rows.items()
        if fields[row.field] is None
        and (row.field in ESSENTIAL or (row.field == "cycle_us" and not known))
    ]
    if missing:
        several = len(missing) > 1
        raise ClusterFileError(
            f"{where}: element{'s' * several} {', '.join(missing)} {'are' if several else 'is'} "
            f"missing; add {'them' if several else 'it'} to the <{form.parent}>"
        )


def _bit_rate_mbps(
    rate: float | None, bit_us: float | None, form: Format, where: str
) -> float | None:
    """Return the bit rate of a rate (bit/s) and BIT; one of them may be missing, or both."""
    if rate is None and bit_us is None:
        return None
    tag, rate, bit_us = form.rate.rpartition("}")[2], (rate or 0.0) / 1e6, bit_us or 0.0
    if not rate and not bit_us:
        raise ClusterFileError(f"{where}: <{tag}> and <BIT> are 0; state the rate in bit/s")
    if rate and bit_us and abs(rate * bit_us - 1.0) > 1e-6:
        raise ClusterFileError(
            f"{where}: <{tag}> says {rate:g} Mbit/s, but <BIT> {bit_us:g} us; correct one"
        )
    return rate or round(1.0 / bit_us, 6)


def _controller_fields(
    form: Format, controllers: Sequence[Element], period_us: float | None
) -> tuple[dict[str, Any], list[str]]:
    """Return the controllers' values: the earliest pLatestTx, the longest payload, the widest
    correction of any, and all key slots; and a line for limits that differ.

    The microtick is that of the first controller that has one, or so many sample clock periods;
    controllers may differ in clocks.
    """

    def stated(tag: str, kind: type) -> list[Any]:
        values = [form.read(one, tag, kind, "controller") for one in controllers]
        return [value for value in values if value is not None]

    found: dict[str, Any] = {}
    notes: list[str] = []
    for tag, row in form.tags(_NODE_PART).items():
        if values := stated(tag, row.kind):
            found[row.field] = row.of_several(values)
        if row.field == "latest_transmission_minislot" and len(set(values)) > 1:
            notes.append(
                f"<{tag}> is {min(values)} to {max(values)}; each frame keeps that of its sender, "
                f"and one without a sender has {min(values)}"
            )
    samples = stated("SAMPLES-PER-MICROTICK", int)
    if "microtick_us" not in found and samples and period_us:
        found["microtick_us"] = round(samples[0] * period_us, 9)
    sync, startup = form.key_slots(controllers)
    return {
        **found, "sync_slots": tuple(sorted({*sync, *startup})), "startup_slots": tuple(startup)
    }, notes  # fmt: skip


class Triggering(NamedTuple):
    """A frame in the slots of one channel; `sender` is the name of an ECU, "" if none is known.
    `latest` is the pLatestTx of its controller."""

    frame: str
    frame_id: int
    base_cycle: int
    repetition: int
    channel: str
    payload_bytes: int
    sender: str
    latest: int | None


def read_slots(form: Format, text: str | bytes, name: str | None = None) -> tuple[MessageSlot, ...]:
    """Return the frames that are triggered on the channels of a cluster; `name` chooses it where
    there are several.

    One frame that is triggered alike on both channels is one slot. A frame comes from the ECU
    whose output port belongs to its triggering. ECUs that are called node_0, node_1, ... keep these
    numbers; others are numbered in the order of the file. A frame without a sender gets a number of
    its own after them.

    Raises:
        ClusterFileError: the document describes no cluster, or a triggering lacks its frame.
    """
    root = parse_document(text, form.name).root
    element = find_cluster(form, root, name)
    channels: dict[Triggering, set[str]] = {}
    for one in triggerings(form, root, element):
        channels.setdefault(one._replace(channel=""), set()).add(one.channel)
    # That of the cluster is the smallest of all.
    least = _least_latest(form, root, element)
    used = {one.sender for one in channels}
    numbers = _numbers([name for name in form.ecu_names(root) if name and name in used])
    following = max(numbers.values(), default=-1) + 1
    slots: list[MessageSlot] = []
    for one in sorted(channels, key=lambda key: (key.frame_id, key.base_cycle, key.frame)):
        node = numbers.get(one.sender)
        if node is None:
            node, following = following, following + 1
        slots.append(
            MessageSlot(
                frame_id=one.frame_id,
                # A payload is counted in words of two bytes.
                payload_bytes=one.payload_bytes + one.payload_bytes % 2,
                node=node,
                channel=cast(Channels, "".join(sorted(channels[one]))),
                base_cycle=one.base_cycle,
                repetition=one.repetition,
                latest_transmission_minislot=one.latest if one.latest != least else None,
            )
        )
    return tuple(slots)


def _least_latest(form: Format, root: Element, cluster: Element) -> int | None:
    controllers = form.controllers(root, cluster, "cluster")
    values = [form.read(one, "LATEST-TX", int, "controller") for one in controllers]
    return min((value for value in values if value is not None), default=None)


def triggerings(form: Format, root: Element, cluster: Element) -> Iterator[Triggering]:
    """Yield the frames that are triggered on the channels of a cluster, channel by channel.

    Raises:
        ClusterFileError: a triggering lacks its frame or its slot.
    """
    cycles = 1 + (form.read(form.values(cluster), "CYCLE-COUNT-MAX", int, "cluster") or 63)
    frame_of = form.frames(root)
    for channel, letter in form.channels(root, cluster):
        for one in channel.iter(form.triggering):
            where, frame, length, sender, controller = frame_of(one)
            latest = None
            if controller is not None:
                latest = form.read(controller, "LATEST-TX", int, "controller")
            for timing in one.iter(form.timing):
                if frame is None or length is None:
                    raise ClusterFileError(
                        f"{where}: it refers to frame {frame!r}, which is not there or has no "
                        f"<{form.length}>; add them"
                    )
                slot, base, repetition = form.turn(timing, cycles, where)
                if slot is None:
                    raise ClusterFileError(f"{where}: element <SLOT-ID> is missing; add it")
                yield Triggering(frame, slot, base or 0, repetition, letter, length, sender, latest)


def _numbers(ecus: Sequence[str]) -> dict[str, int]:
    named = [_NODE.fullmatch(name) for name in ecus]
    if all(named):
        return {match.group(): int(match.group(1)) for match in named if match}
    return {name: number for number, name in enumerate(dict.fromkeys(ecus))}


def frame_name(slot: MessageSlot) -> str:
    """Return a name that no other slot of a table has."""
    return f"frame_{slot.frame_id}_{slot.base_cycle}_{slot.repetition}_{slot.channel}"


def ecu_name(node: int) -> str:
    """Return the name of the ECU of a node."""
    return f"node_{node}"


def latest_of_nodes(slots: Sequence[MessageSlot], cluster: Callable[[], Cluster]) -> dict[int, int]:
    """Return the pLatestTx of each node for its controller; none where no slot has its own."""
    if all(slot.latest_transmission_minislot is None for slot in slots):
        return {}
    usual = cluster().latest_transmission_minislot
    found: dict[int, int] = {}
    for slot in slots:
        own = slot.latest_transmission_minislot
        found[slot.node] = min(found.get(slot.node, MAX_MINISLOTS), usual if own is None else own)
    return found


def without_element(slots: Sequence[MessageSlot]) -> tuple[str, ...]:
    """Return the fields that a table states and no frame triggering holds."""
    return tuple(
        field
        for field in SLOT_FIELDS_WITHOUT_ELEMENT
        if any(getattr(slot, field) is not None for slot in slots)
    )
