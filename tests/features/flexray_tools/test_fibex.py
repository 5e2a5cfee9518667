"""FIBEX: the published sample, the round trip, and documents that are wrong."""

import re

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.clock_constraints import offset_correction_macroticks
from concord.bus.flexray.cluster_files import cluster_from_toml, cluster_to_toml
from concord.bus.flexray.presets import AUDI, DEMO
from concord.features.flexray_tools.files.fibex import (
    FIBEX,
    WITHOUT_ELEMENT,
    cluster_from_fibex,
    cluster_to_fibex,
)
from concord.features.flexray_tools.files.xml_document import ClusterFileError
from tests.bus.support import quick
from tests.bus.test_clocks import PRODUCTION


def test_the_sample_loads_and_meets_constraint_18_exactly(sample_fibex: str):
    cluster = cluster_from_fibex(sample_fibex.encode())
    assert cluster.action_point_difference_macroticks == 3
    assert 62 * 65 + 3 + 10 * 62 + 139 + 208 == cluster.macroticks_per_cycle == 5000
    assert (cluster.static_slots, cluster.static_slot_macroticks) == (62, 65)
    assert (cluster.minislots, cluster.minislot_macroticks) == (10, 62)
    assert (cluster.name, cluster.channels) == ("FlexRayNetwork_1", "AB")
    assert (cluster.cycle_us, cluster.macrotick_us, cluster.bit_rate_mbps) == (5000.0, 1.0, 10.0)
    assert cluster.static_payload_words == 21
    assert cluster_from_fibex(cluster_to_fibex(cluster)) == cluster


def test_the_sample_without_a_field_or_with_a_contradiction_names_it(sample_fibex: str):
    for element in ("STATIC-SLOT", "MINISLOT", "NUMBER-OF-STATIC-SLOTS", "PAYLOAD-LENGTH-STATIC"):
        pattern = rf"<flexray:{element} [^>]*>[^<]*</flexray:{element}>"
        without, count = re.subn(pattern, "", sample_fibex)
        assert count == 1
        with pytest.raises(ClusterFileError, match=f"<flexray:{element}>.*missing"):
            cluster_from_fibex(without)
    with pytest.raises(ClusterFileError, match=r"constraint 18.*4997.*N-I-T"):
        cluster_from_fibex(sample_fibex.replace(">208<", ">205<"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<flexray:CYCLE>10000.0<", "<flexray:CYCLE>5000.0<", r"constraint 17.*MACROTICK"),
        ("<flexray:STATIC-SLOT>272<", "<flexray:STATIC-SLOT>long<", "STATIC-SLOT.*'long'"),
        ("<flexray:STATIC-SLOT>272<", "<flexray:STATIC-SLOT>1<", "gdStaticSlot"),
        ("<flexray:MACROTICK>1.0<", "<flexray:MACROTICK>nan<", "MACROTICK"),
        ("<flexray:CYCLE>10000.0<", "<flexray:CYCLE>inf<", "CYCLE"),
        ("<flexray:MICROTICK>0.025<", "<flexray:MICROTICK>0<", "pdMicrotick"),
        ("<flexray:BIT>0.1<", "<flexray:BIT>0.2<", "SPEED.*BIT"),
        ("<flexray:BIT>0.1<", "<flexray:BIT>nan<", "BIT"),
        ("<flexray:N-I-T>160<", "<flexray:N-I-T>9</flexray:N-I-T><flexray:N-I-T>160<", "N-I-T"),
        ("<fx:CHANNEL-REF ID-REF=", "<fx:CHANNEL-REF ID-FER=", "CHANNEL-REF"),
        ("NEL-NAME>A<", "NEL-NAME>C<", "FLEXRAY-CHANNEL-NAME"),
        ("<ho:SHORT-NAME>demo<", "<ho:SHORT-NAME><", "SHORT-NAME"),
        ("xmlns:flexray=", "xmlns:flexray='urn:other' xmlns:other=", "no <CLUSTER>"),
    ],
)
def test_missing_and_contradictory_elements_are_named(old: str, new: str, said: str):
    text = cluster_to_fibex(DEMO)
    assert old in text
    with pytest.raises(ClusterFileError, match=said):
        cluster_from_fibex(text.replace(old, new, 1))


def test_a_missing_bit_rate_is_usual_and_named():
    text = re.sub(
        r"<fx:SPEED>.*</fx:SPEED>|<flexray:BIT>.*</flexray:BIT>", "", cluster_to_fibex(DEMO)
    )
    cluster, notes = FIBEX.read(text.encode(), None)
    assert cluster == DEMO
    (note,) = notes
    assert "<SPEED> and <BIT>" in note and "bit_rate_mbps is taken to be 10.0" in note


def test_without_a_controller_the_segment_decides_what_may_be_sent_when():
    text = re.sub(r"<fx:ECUS>.*</fx:ECUS>", "", cluster_to_fibex(AUDI), flags=re.DOTALL)
    cluster, notes = FIBEX.read(text.encode(), None)
    assert cluster == AUDI
    assert [note.partition("; ")[2].split()[0] for note in notes] == [
        "microtick_us", "dynamic_payload_words", "latest_transmission_minislot",
    ]  # fmt: skip


def test_one_of_several_clusters_is_chosen_by_name():
    one, other = cluster_to_fibex(DEMO), cluster_to_fibex(DEMO).replace(">demo<", ">second<")
    second = re.search(r"<fx:CLUSTER ID.*</fx:CLUSTER>", other, flags=re.DOTALL)
    assert second is not None
    both = one.replace("</fx:CLUSTERS>", second.group() + "</fx:CLUSTERS>")
    assert cluster_from_fibex(both, "second").name == "second"
    with pytest.raises(ClusterFileError, match=r"several.*'demo', 'second'"):
        cluster_from_fibex(both)
    with pytest.raises(ClusterFileError, match="no <CLUSTER> 'third'"):
        cluster_from_fibex(both, "third")


@quick
@given(st.one_of(st.binary(max_size=200), st.text(max_size=200)))
def test_any_bytes_are_refused_politely(text: str | bytes):
    with pytest.raises(ClusterFileError):
        cluster_from_fibex(text)


@pytest.mark.parametrize("printed", ["1.375", "1.3751", "1.37513751375"])
def test_production_clusters_are_read_with_the_macrotick_as_printed(printed: str):
    """5 ms in 3,636 macroticks; the cycle is the truth in TOML and FIBEX."""
    fibex = cluster_to_fibex(PRODUCTION)
    toml = cluster_to_toml(PRODUCTION)
    exact = repr(5000 / 3636)
    assert exact in fibex and exact in toml
    for cluster in (
        cluster_from_fibex(fibex.replace(f">{exact}<", f">{printed}<")),
        cluster_from_toml(toml.replace(exact, printed)),
    ):
        assert cluster == PRODUCTION
        assert cluster.macrotick_us * 3636 == pytest.approx(5000, abs=1e-9)


def test_published_offset_corrections_follow_from_equation_17(sample_fibex: str):
    """Corrections of three published clusters begin where the formula has them begin."""
    largest_us = 127 * 0.025 * 0.9985
    assert offset_correction_macroticks(PRODUCTION, largest_us) == 3636 - 3632
    sample = cluster_from_fibex(sample_fibex)
    assert sample.offset_correction_us == pytest.approx(6.449)
    assert sample.offset_correction_start_macroticks == 4987
    assert offset_correction_macroticks(sample, 6.449) == 5000 - 4987
    # CTU-IIG's calculator: 4.406 us take 9 macroticks of 1 us.
    assert offset_correction_macroticks(DEMO, 4.406) == 9


def test_clock_parameters_survive_both_formats():
    stated = msgspec.structs.replace(PRODUCTION, precision_us=2.65, propagation_delay_us=0.25)
    assert cluster_from_toml(cluster_to_toml(stated)) == stated
    open_again = msgspec.structs.replace(stated, **dict.fromkeys(WITHOUT_ELEMENT))
    assert cluster_from_fibex(cluster_to_fibex(stated)) == open_again


def two_clusters() -> str:
    """A document of two clusters, whose controllers hang on their own channels."""
    silent = msgspec.structs.replace(PRODUCTION, channels="A", sync_slots=(), startup_slots=())
    text = cluster_to_fibex(silent)
    other = cluster_to_fibex(DEMO)
    for word in ("cluster", "channel_A", "controller", "ecu"):
        other = other.replace(f'"{word}', f'"other_{word}')
    connector = (
        '<fx:CONNECTORS><fx:CONNECTOR ID="{0}connector"><fx:CHANNEL-REF ID-REF="{0}channel_A"/>'
        '<fx:CONTROLLER-REF ID-REF="{0}controller"/></fx:CONNECTOR></fx:CONNECTORS></fx:ECU>'
    )

    def part(document: str, name: str) -> str:
        return document[document.index(f"<fx:{name}>") :].split(f"</fx:{name}>")[0]

    text = text.replace("</fx:ECU>", connector.format(""))
    other = other.replace("</fx:ECU>", connector.format("other_"))
    for name in ("CLUSTERS", "CHANNELS", "ECUS"):
        inside = part(other, name).removeprefix(f"<fx:{name}>")
        text = text.replace(f"</fx:{name}>", f"{inside}</fx:{name}>")
    return text


def test_controllers_belong_to_the_cluster_of_their_channels():
    text = two_clusters()
    assert cluster_from_fibex(text, "demo").latest_transmission_minislot == 516
    assert cluster_from_fibex(text, "production").latest_transmission_minislot == 249


def test_a_microtick_may_be_given_in_sample_clock_periods():
    text = cluster_to_fibex(DEMO)
    period = "<flexray:SAMPLE-CLOCK-PERIOD>0.0125</flexray:SAMPLE-CLOCK-PERIOD><flexray:BIT>"
    samples = "<flexray:SAMPLES-PER-MICROTICK>1</flexray:SAMPLES-PER-MICROTICK>"
    text = text.replace("<flexray:BIT>", period).replace("400000", "800000")
    text = text.replace("<flexray:MICROTICK>0.025</flexray:MICROTICK>", samples)
    cluster = cluster_from_fibex(text)
    assert (cluster.microtick_us, cluster.microticks_per_cycle) == (0.0125, 800000)
