"""docs/flexray_toolbox.md: its code runs as printed, and names every tool of cc.flexray."""

from pathlib import Path

import pytest

import concord as cc
from concord.features.flexray_tools import api as flexray
from tests.pages import ROOT, blocks

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "flexray_toolbox.md").read_text(encoding="utf-8")


def test_the_code_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.chdir(tmp_path)
    namespace: dict = {}
    for block in blocks(PAGE, "python"):
        exec(block, namespace)
    said = capsys.readouterr().out
    assert "frame-crc 60" in said and "constraint 18" in said
    # The recording shows the slot and the minislot of the cluster that was sent.
    fitted, made = namespace["fitted"], namespace["made"].cluster
    assert fitted.static_slot_us == pytest.approx(29 * 5000 / 2778, abs=0.01)
    assert fitted.minislot_us == pytest.approx(5 * 5000 / 2778, abs=0.01)
    assert (made.static_slots, made.static_payload_words, made.startup_slots) == (51, 17, (3, 5))
    few, best = namespace["few"], namespace["best"]
    assert best.error < few.error and few.used_slots < best.used_slots
    assert "[0.005 0.01 ] [20.  20.1]" in said
    made_files = {"bus.pcap", "car.arxml", "drive.csv", "frames.csv", "slots.toml"}
    assert {path.name for path in tmp_path.iterdir()} == made_files


def test_the_toolbox_is_one_public_module_and_complete():
    namespace: dict = {}
    exec("from concord import flexray", namespace)
    assert getattr(cc, "flexray") is namespace["flexray"] is flexray  # noqa: B009
    assert all(hasattr(flexray, name) for name in flexray.__all__)
    functions = [name for name in flexray.__all__ if name.islower()]
    missing = [name for name in functions if name not in PAGE]
    # Readers of text and tables stand in the reference.
    assert set(missing) <= {"cluster_from_toml", "slots_from_toml", "read_demand"}
