"""FIBEX and AUTOSAR files: clusters and slot tables there and back, and all else kept."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.presets import AUDI, DEMO, PRESETS
from concord.bus.flexray.slot_file import SlotFileError, checked_slots, read_slot_file
from concord.features.flexray_tools.files.arxml import (
    ARXML,
    arxml_with_slots,
    cluster_from_arxml,
    cluster_to_arxml,
    slots_from_arxml,
)
from concord.features.flexray_tools.files.arxml import WITHOUT_ELEMENT as NOT_IN_ARXML
from concord.features.flexray_tools.files.fibex import (
    FIBEX,
    cluster_from_fibex,
    cluster_to_fibex,
    fibex_with_slots,
    slots_from_fibex,
)
from concord.features.flexray_tools.files.fibex import WITHOUT_ELEMENT as NOT_IN_FIBEX
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    document_text,
    in_seconds,
    microseconds,
    parse_document,
)
from tests.bus.support import clusters, quick

BOTH = msgspec.structs.replace(AUDI, channels="AB")


class Format(NamedTuple):
    """The reader and the writers of an exchange format."""

    read: Callable[..., Cluster]
    read_slots: Callable[..., tuple[MessageSlot, ...]]
    write: Callable[..., str]
    with_slots: Callable[..., str]
    lacking: Sequence[str]


FORMATS = {
    "fibex": Format(
        cluster_from_fibex, slots_from_fibex, cluster_to_fibex, fibex_with_slots, NOT_IN_FIBEX
    ),
    "arxml": Format(
        cluster_from_arxml, slots_from_arxml, cluster_to_arxml, arxml_with_slots, NOT_IN_ARXML
    ),
}
each_format = pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS)


@st.composite
def slot_tables(draw: st.DrawFn) -> tuple[MessageSlot, ...]:
    made: list[MessageSlot] = []
    for frame_id in sorted(draw(st.sets(st.integers(1, 2047), min_size=1, max_size=7))):
        repetition = draw(st.sampled_from([1, 2, 4, 8, 16, 32, 64]))
        bases = draw(st.sets(st.integers(0, repetition - 1), min_size=1, max_size=2))
        for base in sorted(bases):
            made.append(
                MessageSlot(
                    frame_id=frame_id,
                    payload_bytes=2 * draw(st.integers(0, 17 if frame_id <= 51 else 127)),
                    node=draw(st.integers(0, 40)),
                    channel=draw(st.sampled_from(["A", "B", "AB"])),
                    base_cycle=base,
                    repetition=repetition,
                )
            )
    return checked_slots(made, BOTH)


@each_format
@settings(parent=quick, max_examples=30)
@given(cluster=clusters())
def test_any_cluster_survives(form: Format, cluster: Cluster):
    assert form.read(form.write(cluster).encode()) == cluster


@each_format
@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_with_the_clocks_that_a_format_holds(form: Format, name: str):
    clocks = msgspec.structs.replace(
        PRESETS[name],
        sync_slots=(1, 2, 5),
        startup_slots=(1, 2),
        cold_start_attempts=8,
        listen_noise=2,
        halt_after_cycle_pairs=3,
        passive_after_cycle_pairs=2,
        drift_damping_microticks=1,
        sync_nodes_most=4,
        offset_correction_microticks=150,
        rate_correction_microticks=601,
        startup_range_microticks=110,
    )
    assert form.read(form.write(clocks)) == clocks


@each_format
@quick
@given(slots=slot_tables())
def test_any_slot_table_survives_and_leaves_the_cluster_alone(form: Format, slots):
    text = form.write(BOTH, slots)
    assert form.read_slots(text.encode()) == slots
    assert form.read(text) == BOTH
    # Another table takes its place; the first leaves nothing behind in the schedule.
    assert form.read_slots(form.with_slots(text, slots[:1])) == slots[:1]
    assert form.read_slots(form.with_slots(text, ())) == ()


@given(st.floats(1e-3, 2e4))
def test_seconds_are_exact_microseconds(time_us: float):
    assert microseconds(in_seconds(time_us)) == time_us


@each_format
def test_what_a_format_does_not_hold_is_exactly_what_it_loses(form: Format):
    stated = msgspec.structs.replace(
        DEMO, precision_us=2.0, propagation_delay_us=0.1, offset_correction_us=5.0,
        offset_correction_start_macroticks=9900, offset_correction_microticks=300,
    )  # fmt: skip
    read = form.read(form.write(stated))
    lost = [
        field
        for field, value in msgspec.structs.asdict(stated).items()
        if getattr(read, field) != value
    ]
    assert lost == [field for field in lost if field in form.lacking] != []
    assert {"precision_us", "propagation_delay_us"} <= set(lost)


def kinds(text: str) -> list[str]:
    return sorted(element.tag for element in ElementTree.fromstring(text).iter())


def test_every_element_of_a_foreign_file_is_kept(sample_fibex: str):
    """54 kinds of element and comments, with the prefixes that attribute values speak of."""
    text = document_text(parse_document(sample_fibex.encode(), "FIBEX"))
    assert kinds(text) == kinds(sample_fibex)
    assert 'xsi:type="flexray:CLUSTER-TYPE"' in text and "xmlns:flexray=" in text
    assert re.findall("<!--.*?-->", text, re.DOTALL) == re.findall(
        "<!--.*?-->", sample_fibex, re.DOTALL
    )
    slots = [MessageSlot(frame_id=3, payload_bytes=8, node=2, channel="AB")]
    edited = fibex_with_slots(sample_fibex, slots)
    assert set(kinds(sample_fibex)) < set(kinds(edited))
    assert slots_from_fibex(edited) == tuple(slots)
    assert cluster_from_fibex(edited) == cluster_from_fibex(sample_fibex)


FOREIGN = """<?xml version="1.0"?>
<a:AUTOSAR xmlns:a="http://autosar.org/schema/r4.0" xmlns:v="urn:vendor">
 <!-- kept --><a:AR-PACKAGES><a:AR-PACKAGE><a:SHORT-NAME>p</a:SHORT-NAME><a:ELEMENTS>
 <a:ECU-INSTANCE><a:SHORT-NAME>brake</a:SHORT-NAME><a:CONNECTORS>
  <a:FLEXRAY-COMMUNICATION-CONNECTOR><a:SHORT-NAME>c</a:SHORT-NAME>
   <a:ECU-COMM-PORT-INSTANCES>
    <a:FRAME-PORT><a:SHORT-NAME>in</a:SHORT-NAME>
     <a:COMMUNICATION-DIRECTION>IN</a:COMMUNICATION-DIRECTION></a:FRAME-PORT>
    <a:FRAME-PORT><a:SHORT-NAME>out</a:SHORT-NAME>
     <a:COMMUNICATION-DIRECTION>OUT</a:COMMUNICATION-DIRECTION></a:FRAME-PORT>
   </a:ECU-COMM-PORT-INSTANCES></a:FLEXRAY-COMMUNICATION-CONNECTOR>
 </a:CONNECTORS></a:ECU-INSTANCE>
 <a:FLEXRAY-FRAME><a:SHORT-NAME>f</a:SHORT-NAME><a:FRAME-LENGTH>7</a:FRAME-LENGTH></a:FLEXRAY-FRAME>
 <a:FLEXRAY-CLUSTER><a:SHORT-NAME>net</a:SHORT-NAME><v:OWN a:K="1">x</v:OWN>
  <a:PHYSICAL-CHANNELS><a:FLEXRAY-PHYSICAL-CHANNEL><a:SHORT-NAME>ch</a:SHORT-NAME>
   <a:FRAME-TRIGGERINGS>
    <a:FLEXRAY-FRAME-TRIGGERING><a:SHORT-NAME>t</a:SHORT-NAME>
     <a:FRAME-PORT-REFS><a:FRAME-PORT-REF>/p/brake/c/in</a:FRAME-PORT-REF>
      <a:FRAME-PORT-REF>/p/brake/c/out</a:FRAME-PORT-REF></a:FRAME-PORT-REFS>
     <a:FRAME-REF>/p/f</a:FRAME-REF>
     <a:FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING><a:COMMUNICATION-CYCLE><a:CYCLE-COUNTER>
       <a:CYCLE-COUNTER>5</a:CYCLE-COUNTER></a:CYCLE-COUNTER></a:COMMUNICATION-CYCLE>
      <a:SLOT-ID>60</a:SLOT-ID></a:FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING>
     <a:FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING>
      <a:SLOT-ID>61</a:SLOT-ID></a:FLEXRAY-ABSOLUTELY-SCHEDULED-TIMING>
    </a:FLEXRAY-FRAME-TRIGGERING>
   </a:FRAME-TRIGGERINGS><a:CHANNEL-NAME>CHANNEL-B</a:CHANNEL-NAME>
  </a:FLEXRAY-PHYSICAL-CHANNEL></a:PHYSICAL-CHANNELS>
  <a:CYCLE-COUNT-MAX>63</a:CYCLE-COUNT-MAX></a:FLEXRAY-CLUSTER>
</a:ELEMENTS></a:AR-PACKAGE></a:AR-PACKAGES></a:AUTOSAR>"""


def test_a_foreign_autosar_file_by_hand():
    slots = slots_from_arxml(FOREIGN)
    first, second = slots
    assert (first.frame_id, first.base_cycle, first.repetition) == (60, 5, 64)
    assert (second.frame_id, second.base_cycle, second.repetition) == (61, 0, 1)
    # Seven bytes take four words; one ECU sends both.
    assert {(one.payload_bytes, one.node, one.channel) for one in slots} == {(8, 0, "B")}
    text = document_text(parse_document(FOREIGN, "ARXML"))
    assert kinds(text) == kinds(FOREIGN) and "<!-- kept -->" in text and 'a:K="1"' in text
    with pytest.raises(ClusterFileError) as refused:
        cluster_from_arxml(FOREIGN)
    # The sentence names every missing element.
    for element in ("CYCLE>", "MINISLOT-DURATION", "STATIC-SLOT-DURATION", "PAYLOAD-LENGTH"):
        assert element in str(refused.value)
    with pytest.raises(ClusterFileError, match="is not there or has no <FRAME-LENGTH>"):
        slots_from_arxml(FOREIGN.replace("/p/f<", "/p/g<"))
    with pytest.raises(ClusterFileError, match="element <SLOT-ID> is missing"):
        slots_from_arxml(FOREIGN.replace("<a:SLOT-ID>61</a:SLOT-ID>", ""))


THIN = (
    "ACTION-POINT-OFFSET", "DYNAMIC-SLOT-IDLE-PHASE", "MINISLOT-ACTION-POINT-OFFSET", "N-I-T",
    "T-S-S-TRANSMITTER", "SYMBOL-WINDOW", "MACRO-PER-CYCLE", "MACROTICK", "BIT",
)  # fmt: skip


def test_a_thin_export_takes_usual_values_and_says_so():
    """Nine elements and the references to channels are missing."""
    text = cluster_to_fibex(DEMO)
    for tag in THIN:
        text = re.sub(f"<flexray:{tag}>[^<]*</flexray:{tag}>", "", text)
    text = re.sub("<fx:SPEED>.*</fx:SPEED>|<fx:CHANNEL-REFS>.*</fx:CHANNEL-REFS>", "", text)
    cluster, notes = FIBEX.read(text.encode(), None)
    # The demo has its widest action points.
    assert cluster.channels == DEMO.channels and cluster.cycle_us == DEMO.cycle_us
    assert cluster.macrotick_us == 1.0 and cluster.bit_rate_mbps == 10.0
    assert cluster.macroticks_per_cycle == DEMO.macroticks_per_cycle
    named = " ".join(notes)
    for tag in set(THIN) - {"BIT"}:
        assert f"<{tag}> is missing" in named
    assert "<CHANNEL-REF>" not in named and "<SPEED> and <BIT>" in named
    assert len(notes) == len(THIN)


def test_elements_without_a_usual_value_are_named_at_once():
    text = cluster_to_fibex(DEMO)
    for tag in ("CYCLE", "MACROTICK", "MACRO-PER-CYCLE", "STATIC-SLOT", "MINISLOT"):
        text = re.sub(f"<flexray:{tag}>[^<]*</flexray:{tag}>", "", text)
    with pytest.raises(ClusterFileError) as refused:
        cluster_from_fibex(text)
    for said in ("<flexray:CYCLE>", "<flexray:STATIC-SLOT> (static_slot", "<flexray:MINISLOT>"):
        assert said in str(refused.value)
    assert "elements" in str(refused.value) and "\n" not in str(refused.value)


SENT = (
    MessageSlot(frame_id=14, payload_bytes=200, node=0),
    MessageSlot(frame_id=15, payload_bytes=200, node=1, latest_transmission_minislot=560),
    MessageSlot(frame_id=16, payload_bytes=16, node=1, latest_transmission_minislot=560),
    MessageSlot(frame_id=40, payload_bytes=16, node=1, latest_transmission_minislot=560),
)
"""Two ECUs, the second of which may begin frames later."""


@pytest.mark.parametrize(
    ("written", "read", "slots"),
    [
        (cluster_to_fibex, cluster_from_fibex, slots_from_fibex),
        (cluster_to_arxml, cluster_from_arxml, slots_from_arxml),
    ],
)
def test_each_frame_keeps_the_latest_minislot_of_its_ecu(written, read, slots):
    text = written(DEMO, SENT)
    assert read(text) == DEMO and slots(text) == SENT
    (note,) = (FIBEX if written is cluster_to_fibex else ARXML).read(text.encode(), None)[1]
    assert "<LATEST-TX> is 516 to 560; each frame keeps that of its sender" in note


def test_clusters_of_one_autosar_file_keep_their_own_controllers():
    other = msgspec.structs.replace(DEMO, name="second", latest_transmission_minislot=400)
    one, two = (
        re.search("<AR-PACKAGE>.*</AR-PACKAGE>", cluster_to_arxml(cluster), re.DOTALL)
        for cluster in (DEMO, other)
    )
    assert one is not None and two is not None
    second = two.group().replace("/concord/", "/other/").replace(">concord<", ">other<")
    both = cluster_to_arxml(DEMO).replace(one.group(), one.group() + second)
    assert cluster_from_arxml(both, "demo") == DEMO
    assert cluster_from_arxml(both, "second") == other
    with pytest.raises(ClusterFileError, match=r"several.*'demo', 'second'"):
        cluster_from_arxml(both)
    with pytest.raises(ClusterFileError, match="no <FLEXRAY-CLUSTER> 'third'"):
        cluster_from_arxml(both, "third")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<CYCLE>0.0100000</CYCLE>", "<CYCLE>0.005</CYCLE>", "constraint 17.*MACROTICK-DURATION"),
        ("STATIC-SLOT-DURATION>272<", "STATIC-SLOT-DURATION>long<", "STATIC-SLOT-DURATION.*'long'"),
        ("CHANNEL-A<", "CHANNEL-C<", "must be CHANNEL-A or CHANNEL-B"),
        ("<BIT>1E-7</BIT>", "<BIT>2E-7</BIT>", "BAUDRATE.*BIT"),
        ("http://autosar.org/schema/r4.0", "urn:other", "no <FLEXRAY-CLUSTER>"),
        ("<SHORT-NAME>demo<", "<SHORT-NAME><", "SHORT-NAME"),
        ("</AUTOSAR>", "", "not well-formed"),
        ("</FLEXRAY-CLUSTER-VARIANTS>", "<FLEXRAY-CLUSTER-CONDITIONAL/></FLEXRAY-CLUSTER-VARIANTS>",
         "2 variants"),
    ],
)  # fmt: skip
def test_wrong_autosar_files_are_one_sentence(old: str, new: str, said: str):
    text = cluster_to_arxml(DEMO)
    assert old in text, text[:3000]
    with pytest.raises(ClusterFileError, match=said) as refused:
        cluster_from_arxml(text.replace(old, new))
    assert "\n" not in str(refused.value)


def entity_bomb(encoding: str) -> bytes:
    entities = "".join(f'<!ENTITY e{level + 1} "{f"&e{level};" * 10}">' for level in range(30))
    return (
        f'<?xml version="1.0" encoding="{encoding}"?>'
        f'<!DOCTYPE f [<!ENTITY e0 "ha">{entities}]><f>&e30;</f>'
    ).encode(encoding)


@each_format
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_document_types_are_refused_before_entities_can_grow(form: Format, encoding: str):
    with pytest.raises(ClusterFileError, match="file declares a document type"):
        form.read(entity_bomb(encoding))


@each_format
@settings(parent=quick)
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused(form: Format, data: st.DataObject):
    text = form.write(DEMO, [MessageSlot(frame_id=3, payload_bytes=8)])
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 40)))
    damaged = text[:start] + data.draw(st.text(max_size=5)) + text[end:]
    for read in (form.read, form.read_slots):
        try:
            read(damaged)
        except ClusterFileError as refused:
            assert str(refused)


@each_format
def test_a_schedule_that_no_controller_repeats_is_refused_by_its_frame(form: Format, tmp_path):
    slot = MessageSlot(frame_id=3, payload_bytes=8, base_cycle=1, repetition=5)
    path: Path = tmp_path / ("car.xml" if form is FORMATS["fibex"] else "car.arxml")
    path.write_text(form.write(BOTH, [slot]))
    with pytest.raises(SlotFileError, match="frame ID 3: repetition is 5"):
        read_slot_file(path, BOTH)
