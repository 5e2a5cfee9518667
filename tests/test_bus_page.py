"""docs/bus.md: the commands from a recording to a network run, one after the other."""

from pathlib import Path

import pytest

from tests.pages import ROOT, blocks, link_checkout, run_as_reader

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs" / "bus.md"


def test_a_recording_becomes_a_network_as_the_page_says(tmp_path: Path):
    checkout = link_checkout(tmp_path)
    (chain,) = [
        block
        for block in blocks(PAGE.read_text(encoding="utf-8"), "text")
        if "data/flexray_capture" in block
    ]
    commands = chain.splitlines()
    assert [line.split()[2] for line in commands[:4]] == ["fit", "validate", "wcrt", "plan"]
    assert commands[4].startswith("concord run") and "--slots car_slots.toml" in commands[4]
    for command in commands:
        run_as_reader(command, checkout)


def test_signals_of_a_log_become_an_estimate_as_the_page_says(tmp_path: Path):
    checkout = link_checkout(tmp_path)
    text = PAGE.read_text(encoding="utf-8")
    (chain,) = [block for block in blocks(text, "sh") if "bus_signals" in block]
    said = [run_as_reader(command, checkout) for command in chain.splitlines()]
    assert "front_v: 4 are not valid" in said[1]
    assert said[2].startswith("WORKS") and said[4].startswith("WORKS")
