"""`concord flexray validate` and `convert`: good clusters, broken ones, there and back."""

import re
from pathlib import Path
from typing import get_args

import pytest

from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.levels import LEVELS
from concord.bus.flexray.presets import DEMO, PRESETS
from concord.features.flexray_tools.commands.clusters import Level, derived, read_cluster
from concord.features.flexray_tools.files.fibex import cluster_to_fibex
from tests.experiments.command_support import concord, refused


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_valid_and_their_segments_fill_the_cycle(name: str, capsys):
    said = concord(capsys, "flexray", "validate", name, "--json")
    answer = said.json()
    lengths = [part["end_us"] - part["start_us"] for part in answer["segments"]]
    assert sum(lengths) == pytest.approx(answer["cycle_us"], abs=1e-6)
    cluster = PRESETS[name]
    # Frame: TSS, FSS, ten bits for each byte of 5 + payload + 3, FES, at 10 Mbit/s.
    bits = cluster.transmission_start_bits + 1 + 10 * (8 + cluster.static_payload_bytes) + 2
    assert answer["static_frame_us"] == pytest.approx(bits / 10)
    assert answer["static_frame_us"] < answer["static_slot_us"]
    text = concord(capsys, "flexray", "validate", name).out
    assert f"cluster {name}: valid; keeps levels 2.1, 3.0.1, physical" in text
    assert answer["levels"] == {"2.1": [], "3.0.1": [], "physical": []}
    assert "static slot" in text


def test_a_level_refuses_what_it_alone_demands(tmp_path: Path, capsys):
    """A window of one macrotick holds no symbol, which only the level `physical` minds."""
    path = tmp_path / "window.toml"
    text = with_field("symbol_window_macroticks", 1)
    path.write_text(text.replace("idle_time_macroticks = 160", "idle_time_macroticks = 159"))
    validate = ("flexray", "validate", path)
    said = concord(capsys, *validate).out
    assert "keeps levels 2.1, 3.0.1\n" in said and "level physical: constraint 16" in said
    sentence = refused(concord(capsys, *validate, "--level", "physical"))
    assert "level physical" in sentence and "set 0 or 12" in sentence
    for level in set(get_args(Level)) - {"physical"}:
        assert concord(capsys, *validate, "--level", level).code == 0
    assert set(get_args(Level)) == set(LEVELS)


def test_fibex_tells_what_it_cannot_hold(tmp_path: Path, capsys):
    source, target = tmp_path / "stated.toml", tmp_path / "stated.xml"
    source.write_text(cluster_to_toml(DEMO) + "precision_us = 2.0\n")
    said = concord(capsys, "flexray", "convert", source, target)
    assert "FIBEX has no element for it: precision_us" in said.out


def test_the_audi_cluster_has_the_times_of_the_recording():
    times = derived(read_cluster("audi"))
    assert times.static_slot_us == pytest.approx(52.2, abs=0.01)
    assert times.minislot_us == pytest.approx(9.0, abs=0.01)
    assert times.cycles_repeat_ms == pytest.approx(320.0)


def with_field(field: str, value: object) -> str:
    text, count = re.subn(rf"(?m)^{field} = \S+", f"{field} = {value}", cluster_to_toml(DEMO))
    assert count == 1
    return text


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("a.toml", "static_slots = ", "not TOML"),
        ("a.xml", "<fx", "not well-formed"),
    ],
)
def test_broken_files_are_refused_with_their_name(file, text, says, tmp_path: Path, capsys):
    path = tmp_path / file
    path.write_text(text)
    sentence = refused(concord(capsys, "flexray", "validate", path))
    assert says in sentence and str(path) in sentence


def test_what_is_no_cluster_is_refused(tmp_path: Path, capsys):
    assert "audi" in refused(concord(capsys, "flexray", "validate", "volkswagen"))
    missing = tmp_path / "none.toml"
    assert "No such file" in refused(concord(capsys, "flexray", "validate", missing))
    folder = tmp_path / "folder.xml"
    folder.mkdir()
    assert "directory" in refused(concord(capsys, "flexray", "validate", folder))


def test_a_published_fibex_file_becomes_toml(shared_data: Path, tmp_path: Path, capsys):
    source = shared_data / "fibex" / "fibextest2.xml"
    if not source.exists():
        pytest.skip("needs ../shared/data/fibex")
    target = tmp_path / "cluster.toml"
    said = concord(capsys, "flexray", "convert", source, target, "--json")
    cluster = read_cluster(str(target))
    assert said.json()["cluster"]["static_slots"] == cluster.static_slots == 62
    assert cluster == read_cluster(str(source))
    # 62 x 65 + 10 x 62 + 139 + 208 = 4997; the action points differ by the other 3 macroticks.
    assert cluster.action_point_difference_macroticks == 3


def test_nothing_is_written_over_or_written_wrong(tmp_path: Path, capsys):
    target = tmp_path / "mine.toml"
    target.write_text("precious")
    assert "never written over" in refused(concord(capsys, "flexray", "convert", "demo", target))
    assert target.read_text() == "precious"
    odd = tmp_path / "mine.yaml"
    assert "*.toml" in refused(concord(capsys, "flexray", "convert", "demo", odd))
    assert not odd.exists()
    nowhere = tmp_path / "no" / "mine.xml"
    assert "cannot be written" in refused(concord(capsys, "flexray", "convert", "demo", nowhere))


def test_one_of_several_clusters_is_chosen_by_name(tmp_path: Path, capsys):
    document = cluster_to_fibex(DEMO)
    start = document.index("      <fx:CLUSTER ")
    end = document.index("    </fx:CLUSTERS>")
    second = document[start:end].replace(">demo<", ">spare<").replace('ID="cluster"', 'ID="other"')
    path = tmp_path / "two.xml"
    path.write_text(document[:end] + second + document[end:])
    assert "'demo', 'spare'" in refused(concord(capsys, "flexray", "validate", path))
    said = concord(capsys, "flexray", "validate", path, "--name", "spare", "--json")
    assert said.json()["cluster"]["name"] == "spare"


TABLE = """[[slots]]
frame_id = 3
payload_bytes = 34
node = 1
channel = "A"
base_cycle = 1
repetition = 4

[[slots]]
frame_id = 60
payload_bytes = 88
node = 2
channel = "A"
base_cycle = 0
repetition = 1
"""


def test_a_slot_table_travels_through_every_format(tmp_path: Path, capsys):
    table, back = tmp_path / "slots.toml", tmp_path / "back.toml"
    table.write_text(TABLE)
    fibex, autosar, toml = (tmp_path / f"a{ending}" for ending in (".xml", ".arxml", ".toml"))
    said = concord(capsys, "flexray", "convert", "audi", fibex, "--slots", table)
    assert f"cluster audi of audi is in {fibex} with 2 slots" in said.out
    assert concord(capsys, "flexray", "convert", fibex, autosar, "--json").json()["slots"] == 2
    done = concord(capsys, "flexray", "convert", autosar, toml, "--slots-out", back)
    assert done.code == 0 and "left out" not in done.out
    assert back.read_text() == TABLE
    # Bounds and networks take the exchange formats as they are.
    for file in (fibex, autosar):
        wcrt = concord(capsys, "flexray", "wcrt", file, "--cluster", file, "--json").json()
        assert [frame["frame_id"] for frame in wcrt["frames"]] == [3, 60]


def test_what_a_format_cannot_hold_is_one_line(tmp_path: Path, capsys):
    table = tmp_path / "slots.toml"
    table.write_text(TABLE + "period_us = 5000.0\n")
    target = tmp_path / "a.xml"
    said = concord(capsys, "flexray", "convert", "audi", target, "--slots", table)
    assert "left out, FIBEX has no element for it: period_us\n" in said.out
    plain = concord(capsys, "flexray", "convert", target, tmp_path / "b.toml").out
    assert "left out, a cluster file has no element for it: 2 slots (--slots-out" in plain
    precise = tmp_path / "c.toml"
    precise.write_text(cluster_to_toml(DEMO) + "precision_us = 2.0\ndrift_microticks = 601\n")
    lost = concord(capsys, "flexray", "convert", precise, tmp_path / "c.arxml").out
    assert "left out, AUTOSAR has no element for it: precision_us, drift_microticks\n" in lost


def test_conversions_that_cannot_be_are_one_sentence(tmp_path: Path, capsys):
    table = tmp_path / "slots.toml"
    table.write_text(TABLE.replace("repetition = 4", "repetition = 3"))
    target = tmp_path / "a.arxml"
    for words, says in (
        (("audi", target, "--slots", table), "frame ID 3: repetition is 3"),
        (("audi", target, "--slots", tmp_path / "none.toml"), "No such file"),
        (("audi", tmp_path / "a.toml", "--slots-out", tmp_path / "b.toml"), "has no slot table"),
    ):
        assert says in refused(concord(capsys, "flexray", "convert", *words))
    assert not target.exists()
