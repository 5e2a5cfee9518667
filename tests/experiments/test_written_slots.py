"""`--slots`: a written slot table drives plan and run, and plan hands its own back."""

from pathlib import Path

import numpy as np
import pytest

from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from concord.scenarios.warnings import warnings_of
from concord.studies.near_agreement import departures
from tests.experiments.command_support import concord, refused
from tests.experiments.support import scenario

pytestmark = pytest.mark.slow

NETWORK = ("--scenario", "oscillator", "--nodes", 8, "--graph", "ring", "--cluster", "bosch")


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"occupancy": 0.5, "schedule": "round-robin"},
        {"occupancy": 0.5, "arbiter": "minislot"},
        {"occupancy": 1.0, "schedule": "dynamic", "arbiter": "minislot"},
    ],
)
def test_a_designed_table_gives_the_run_that_it_was_designed_for(options, tmp_path: Path, capsys):
    path = tmp_path / "slots.toml"
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    assert concord(capsys, "flexray", "plan", *NETWORK, *words, "--out", path).code == 0
    network = {"nodes": 8, "graph": "ring", "cluster": "bosch", "steps": 5}
    designed = prepare(scenario("oscillator", **network, **options))
    driven = prepare(scenario("oscillator", **network, slots=str(path)))
    assert driven.scenario.bus.schedule.name == "written"
    one, two = (read_trace(setup, in_memory(setup)) for setup in (designed, driven))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.payload_bytes, two.payload_bytes)
    assert not departures(driven, two)


def test_plan_and_show_take_a_table_and_tell_of_other_stations(tmp_path: Path, capsys):
    path = tmp_path / "slots.toml"
    own = "".join(
        f"[[slots]]\nframe_id = {40 + i}\npayload_bytes = 90\nnode = {i}\n" for i in range(8)
    )
    other = "[[slots]]\nframe_id = 39\npayload_bytes = 200\nnode = 8\n"
    path.write_text(own + other)
    answer = concord(capsys, "flexray", "plan", *NETWORK, "--slots", path, "--json").json()["shown"]
    assert answer["schedule"] == "written" and answer["published"] == 1
    assert [row["frame_ids"] for row in answer["slots"]] == [[40 + i] for i in range(8)]
    # TSS, FSS, FES and ten bits for each of 208 bytes at 10 Mbit/s, once in 5 ms.
    assert answer["other_load"] == pytest.approx((9 + 1 + 2 + 2080) / 10 / 5000)
    text = concord(capsys, "flexray", "plan", *NETWORK, "--slots", path).out
    assert "other stations of the slot table occupy 4.2 % of the bus" in text
    drawn = concord(capsys, "flexray", "show", *NETWORK, "--slots", path, "--json").json()
    assert [frame["frame_id"] for frame in drawn["frames"]] == list(range(40, 48))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--slots", "/nowhere/slots.toml"), "No such file"),
        (("--schedule", "written"), "name its slot table with --slots FILE.toml"),
        (("--slots", "SLOTS", "--cluster", "fitted"), "a slot table belongs to one cluster"),
        (("--slots", "SLOTS", "--occupancy", 0.5), "belongs to --schedule"),
        (("--slots", "SLOTS", "--nodes", 9), "nodes 8 of 9 own no slot"),
        (("--slots", "SLOTS", "--bus", "ideal"), "schedule"),
    ],
)
def test_mistakes_are_one_sentence(arguments, said: str, tmp_path: Path, capsys):
    path = tmp_path / "slots.toml"
    assert concord(capsys, "flexray", "plan", *NETWORK, "--out", path).code == 0
    words = [path if word == "SLOTS" else word for word in arguments]
    kept = [
        word
        for flag, value in zip(NETWORK[::2], NETWORK[1::2], strict=True)
        for word in (flag, value)
        if flag not in words
    ]
    assert said in refused(concord(capsys, "flexray", "plan", *kept, *words))
    again = refused(concord(capsys, "flexray", "plan", *NETWORK, "--out", path))
    assert "exists and is never written over" in again


def test_a_bus_that_does_not_fit_hands_no_table_back(tmp_path: Path, capsys):
    path = tmp_path / "slots.toml"
    full = ("--schedule", "full", "--number", "float64")
    asked = ("--scenario", "target-tracking", "--nodes", 20, *full, "--cluster", "audi")
    assert "does not fit" in refused(concord(capsys, "flexray", "plan", *asked, "--out", path))
    assert not path.exists()


def test_what_a_table_leaves_unheard_is_warned_of(tmp_path: Path):
    turns, crowd = tmp_path / "turns.toml", tmp_path / "crowd.toml"
    turns.write_text(
        "".join(
            f"[[slots]]\nframe_id = {1 + i // 2}\npayload_bytes = 64\nnode = {i}\n"
            f"base_cycle = {i % 2}\nrepetition = 2\n"
            for i in range(4)
        )
    )
    network = {"nodes": 4, "graph": "ring", "cluster": "bosch", "hold": "raw", "rule": "ci"}
    said = " ".join(warnings_of(prepare(scenario("oscillator", **network, slots=str(turns)))))
    assert f"--hold raw with --slots {turns}" in said
    frames = [*range(39, 47), *range(60, 64)]
    crowd.write_text(
        "".join(
            f"[[slots]]\nframe_id = {frame_id}\nnode = {(frame_id - 60) % 99}\n"
            f"payload_bytes = {254 if frame_id < 60 else 90}\n"
            for frame_id in frames
        )
    )
    said = " ".join(warnings_of(prepare(scenario("oscillator", **network, slots=str(crowd)))))
    assert f"--slots {crowd}: 4 nodes contend in dynamic slots, and the segment holds" in said
