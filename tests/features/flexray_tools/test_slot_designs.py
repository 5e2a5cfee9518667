"""`concord flexray design-slots`: a table that wcrt and a network take, and mistakes by name."""

from pathlib import Path

import pytest

from tests.experiments.command_support import concord, refused

pytestmark = pytest.mark.slow

FRAMES = Path(__file__).resolve().parents[3] / "examples" / "frames.toml"
DESIGN = ("flexray", "design-slots", FRAMES, "--cluster", "audi")


def test_a_designed_table_is_bounded_by_its_deadlines_and_drives_a_network(tmp_path, capsys):
    path = tmp_path / "slots.toml"
    text = concord(capsys, *DESIGN, "--out", path).out
    assert "11 entries in 5 of 51 static slots, the least" in text
    frames = concord(capsys, "flexray", "wcrt", path, "--cluster", "audi", "--json").json()
    assert all(frame["spare_us"] >= 0 for frame in frames["frames"])
    network = ("--scenario", "oscillator", "--nodes", 8, "--number", "float32")
    plan = ("flexray", "plan", *network, "--cluster", "audi", "--slots", path, "--json")
    shown = concord(capsys, *plan).json()["shown"]
    assert shown["schedule"] == "written" and shown["other_load"] > 0
    # Ages of 12 ms and 25 ms are at most two and four cycles.
    assert {row["repetition"] for row in shown["slots"]} == {2, 4}


def test_the_goal_decides_between_slots_and_error(capsys):
    few = concord(capsys, *DESIGN, "--json").json()
    best = concord(capsys, *DESIGN, "--minimise", "error", "--json").json()
    # The best has a slot for each share and the brake pedal, and one for the two others.
    assert few["used_slots"] == 5 and best["used_slots"] == 8 + 1 + 1
    alone = concord(capsys, *DESIGN, "--edition", "2.1", "--json").json()
    # Ten nodes with a slot each; the frames of node 9 share theirs.
    assert alone["used_slots"] == 10
    # Every share in every cycle: growths of 4 and seven times 1.
    assert best["error"] == pytest.approx(11 * (5000 + 2 * 5000 / 2778 + 43.2))
    assert best["error"] < few["error"] and best["exact"]


def test_mistakes_are_one_sentence(tmp_path: Path, capsys):
    late = tmp_path / "late.toml"
    late.write_text(FRAMES.read_text().replace("age_us = 12000.0", "age_us = 4000.0"))
    said = refused(concord(capsys, "flexray", "design-slots", late, "--cluster", "audi"))
    assert "share 1 of node 0: it must arrive within 4000 us" in said and str(late) in said
    missing = tmp_path / "none.toml"
    wanted = ("flexray", "design-slots", missing, "--cluster", "audi")
    assert "No such file" in refused(concord(capsys, *wanted))
    assert "volkswagen" in refused(concord(capsys, *DESIGN[:-1], "volkswagen"))
