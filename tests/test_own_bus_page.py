"""The page of own plants behind a measurement bus: its files and its commands."""

import re
from pathlib import Path

import numpy as np
import pytest

import concord as cc
from tests.pages import ROOT, blocks, commands, run_as_reader

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "own_plant_on_a_bus.md").read_text(encoding="utf-8")
ROOMS, HISTORY = blocks(PAGE, "python")


@pytest.mark.zenoh
@pytest.mark.parametrize("command", commands(PAGE))
def test_the_commands_run(command: str, tmp_path: Path):
    (tmp_path / "rooms.py").write_text(ROOMS)
    run_as_reader(command, tmp_path)


def test_the_history_prints_what_the_page_says(capsys: pytest.CaptureFixture[str]):
    exec(compile(HISTORY, "page", "exec"), {})
    cycles, trace = capsys.readouterr().out.split()
    assert f"`{cycles} {trace[:5]}...`" in PAGE


ROW = re.compile(
    r"^\| `(\w+)(?: --method ([\w-]+))?` \| (0\.\d+) \| (\d*) \| (\d+\.\d+) \|$", re.MULTILINE
)


@pytest.mark.parametrize("row", ROW.findall(PAGE), ids=lambda row: " ".join(row[:2]))
def test_the_figures_of_the_receivers_are_those_of_a_run(row: tuple[str, ...]):
    name, method, rmse, outside, half_width = row
    receiver = (
        f"receiver=cc.EllipsoidReceiver(method={method!r})" if method else f"receiver={name!r}"
    )
    house: dict[str, cc.Scenario] = {}
    exec(ROOMS.replace('receiver=cc.EllipsoidReceiver(method="fast-rate")', receiver), house)
    run = cc.simulate(house["SCENARIO"]).isel(run=0, node=0)
    errors = (run["mean"] - run.truth)[10:]
    assert f"{np.sqrt((errors**2).mean().item()):.3f}" == rmse
    assert f"{np.sqrt(run.cov_trace).mean().item():.2f}" == half_width
    if outside:
        assert int((run.nees > 1).sum()) == int(outside)


def test_the_table_has_a_row_for_each_kind_of_receiver():
    assert {name for name, *_ in ROW.findall(PAGE)} == {
        "kf",
        "recommended",
        "ellipsoid",
        "zonotope",
    }
