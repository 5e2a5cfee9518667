"""docs/vehicle.md and its paper's page: commands run, code holds, files are read, names exist."""

import importlib
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from concord.features.vehicle.plant.cars import FITTED_CARS
from concord.features.vehicle.plant.drive_log import ColumnMap, columns_from_toml
from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.network import NODES
from concord.features.vehicle.plant.parameters import ProcessNoise, SensorSheets, car_from_toml
from concord.plants.recorded.units import UNITS
from tests.pages import ROOT, blocks, commands, link_checkout, run_as_reader

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "vehicle.md").read_text(encoding="utf-8")
SENSORS = [name for name in SensorSheets.__struct_fields__ if not name.endswith("_m")]
PAPER = (ROOT / "docs" / "papers" / "adlukf.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return link_checkout(tmp_path_factory.mktemp("vehicle"))


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("vehiclemodels") is None, reason="needs the extra vehicle"
)
@pytest.mark.parametrize("command", commands(PAGE))
def test_a_command_of_the_page_runs(command: str, checkout: Path):
    run_as_reader(command, checkout)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("vehiclemodels") is None, reason="needs the extra vehicle"
)
def test_its_long_sweep_runs_for_a_few_steps(checkout: Path):
    (command,) = re.findall(r"^    (concord sweep [^\n]*\\\n[^\n]*)$", PAGE, re.MULTILINE)
    short = command.replace("--steps 1400 --runs 20", "--steps 5 --runs 2")
    assert short != command
    run_as_reader(f"{short} --workers 1", checkout)


def test_its_python_holds():
    for code in blocks(PAGE, "python"):
        exec(code, {})


def test_its_files_are_read():
    columns, position, car, noise, sensors = blocks(PAGE, "toml")
    assert columns_from_toml(columns).steering_wheel is not None
    receiver = columns_from_toml(columns + position)
    assert receiver.latitude is not None and receiver.longitude is not None
    assert car_from_toml(car).steering_ratio == 15.5
    read = car_from_toml(f"{car}\n{noise}").process_noise
    np.testing.assert_allclose(read.std, ProcessNoise().std, rtol=5e-3)
    assert car_from_toml(f"{car}\n{sensors}").sensors.lateral_acceleration.delay_s == 0.01
    ways = ("`{}`", "sensors.{}", "\n{} = ")
    assert all(any(way.format(name) in PAGE for way in ways) for name in SENSORS)


def test_it_names_all_there_is():
    names = {*FITTED_CARS, *MANOEUVRES, *ColumnMap.__struct_fields__}
    missing = [name for name in names if f"`{name}`" not in PAGE and f"\n{name} = " not in PAGE]
    assert missing == []
    assert all(f"| {node} |" in PAGE for node in NODES)
    (units,) = re.findall(r"Units: ([^.]*)\.", PAGE)
    assert units.replace("\n", " ").split(", ") == list(UNITS)


def test_functions_that_it_names_exist():
    named = re.findall(
        r"`((?:concord\.filters|concord\.papers)\.[a-z_.]+)\.([a-z_]+)`", PAGE + PAPER
    )
    assert len(named) > 8
    for module, function in named:
        assert hasattr(importlib.import_module(module), function), f"{module}.{function}"
