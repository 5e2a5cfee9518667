"""`concord identify-car`: a folder in, a car out."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.features.vehicle.plant.drive_log import write_drive
from concord.features.vehicle.plant.model import axles_of, linear_tyre
from concord.features.vehicle.plant.parameters import BMW_320I, car_from_toml
from tests.experiments.command_support import concord, refused
from tests.features.vehicle.test_tyre_identification import TRUE, drive

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    from concord.features.vehicle.plant.model import tanh_tyre

    write_drive(tmp_path, drive(TRUE, tanh_tyre, 0.06), BMW_320I)
    return tmp_path


def test_it_writes_the_car_that_it_found(folder: Path, capsys):
    out = folder / "found.toml"
    main(
        [
            "identify-car",
            "--data",
            str(folder),
            "--friction",
            "--seek",
            "tyres",
            "--out",
            str(out),
            "--json",
        ]
    )
    said = json.loads(capsys.readouterr().out)
    car = car_from_toml(out.read_text())
    assert car.front_stiffness_n_rad == said["front_stiffness_n_rad"]
    assert car.front_stiffness_n_rad == pytest.approx(TRUE.front_stiffness_n_rad, rel=0.03)
    assert car.friction == pytest.approx(TRUE.friction, rel=0.03)
    assert car.mass_kg == BMW_320I.mass_kg
    assert said["friction_std"] > 0


def test_the_table_shows_what_was_there_before(folder: Path, capsys):
    main(["identify-car", "--data", str(folder), "--tyre", "linear", "--seek", "tyres"])
    text = capsys.readouterr().out
    for words in ("front stiffness, N/rad", "129697", "not sought", "condition number"):
        assert words in text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "name a drive"),
        (["--data", "here", "--manoeuvre", "serpentine"], "not both"),
        (["--manoeuvre", "drift"], "Valid names are double-lane-change"),
        (["--data", "/nowhere"], "no such folder"),
        (["--data", "here", "--log", "there"], "leave --log out"),
        (["--manoeuvre", "serpentine", "--car", "lada"], "Valid names are bmw-320i"),
        (["--manoeuvre", "serpentine", "--seed", "-1"], "--seed -1: must be 0 or more"),
        (["--manoeuvre", "serpentine", "--out", "/dev/null/x"], "cannot be made"),
        (["--manoeuvre", "serpentine", "--min-speed", "-1"], "--min-speed -1: must be 0 or more"),
    ],
)
def test_a_mistake_is_one_sentence(arguments: list[str], says: str, capsys):
    assert says in refused(concord(capsys, "identify-car", *arguments))


def test_nothing_is_written_over(folder: Path, capsys):
    out = folder / "car.toml"
    said = refused(concord(capsys, "identify-car", "--data", folder, "--out", out))
    assert "there is something of that name" in said
    assert car_from_toml(out.read_text()) == BMW_320I


@pytest.mark.skipif(
    importlib.util.find_spec("vehiclemodels") is None, reason="needs the extra vehicle"
)
def test_a_simulated_drive_takes_the_place_of_a_log(capsys):
    main(["identify-car", "--manoeuvre", "step-steer", "--seek", "tyres", "--json"])
    said = json.loads(capsys.readouterr().out)
    # Compliance and load transfer leave more than the data sheet's 130 kN/rad: see docs/vehicle.md.
    assert 125e3 < said["front_stiffness_n_rad"] < 160e3


@pytest.mark.skipif(
    importlib.util.find_spec("vehiclemodels") is None, reason="needs the extra vehicle"
)
def test_a_simulated_log_is_one_that_data_reads(tmp_path: Path, capsys):
    folder, out = tmp_path / "new" / "log", tmp_path / "other" / "car.toml"
    asked = ["--manoeuvre", "step-steer", "--car", "ford-escort", "--seek", "tyres", "--json"]
    main(["identify-car", *asked, "--log", str(folder), "--out", str(out)])
    simulated = json.loads(capsys.readouterr().out)
    main(["identify-car", "--data", str(folder), "--seek", "tyres", "--json"])
    assert json.loads(capsys.readouterr().out) == simulated
    assert simulated["car"] == car_from_toml(out.read_text()).name == "Ford Escort"
    # With the noise of its sensors: what is left over of the yaw rate is no less.
    assert simulated["yaw_rate_rms_rad_s"] > 0.0045


@pytest.mark.study
def test_a_straight_drive_with_a_gap_tells_its_sensors_and_leaves_the_tyres(tmp_path: Path, capsys):
    """A motorway: `identify` refused it, although the verdict on its run had asked for that."""
    straight = drive(TRUE, linear_tyre, 0.001)
    rng = np.random.default_rng(2)
    steering, speed = (
        values + std * rng.standard_normal(straight.steps)
        for values, std in ((straight.steering_rad, 0.0005), (straight.speed_m_s, 0.05))
    )
    steering[300:400] = np.nan
    noisy = straight._replace(steering_rad=steering, speed_m_s=speed)
    write_drive(tmp_path, noisy, BMW_320I)
    out = tmp_path / "found.toml"
    main(["identify-car", "--data", str(tmp_path), "--out", str(out)])
    said = " ".join(capsys.readouterr().out.split())
    assert "The car corners with 0.4 m/s² at most, which tells little of the tyres." in said
    assert "is that of the part from 2.0 to 8.0 s: elsewhere the log has gaps" in said
    car = car_from_toml(out.read_text())
    assert axles_of(car) == axles_of(BMW_320I)
    # No wheel is logged, so the car's own speed is heard as the speed over ground.
    for sheet, noise in ((car.sensors.steering, 0.0005), (car.sensors.ground_speed, 0.05)):
        assert sheet.noise == pytest.approx(noise, rel=0.1)
    refusal = refused(concord(capsys, "identify-car", "--data", tmp_path, "--seek", "tyres"))
    assert "--seek tyres" in refusal and "0.4 m/s² at most" in refusal


@pytest.mark.parametrize("command", ["run --scenario vehicle-network", "identify-car"])
def test_a_drive_whose_car_is_none_is_named(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "car.toml").write_text("mass_kg = 'heavy'")
    monkeypatch.chdir(tmp_path)
    said = refused(concord(capsys, *command.split(), "--data", "drive"))
    assert said.startswith("concord: drive/car.toml: the car file is not valid: ")
    assert [entry.name for entry in tmp_path.iterdir()] == ["drive"]
