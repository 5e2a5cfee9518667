"""Wheels that read too much: the scale is found beside a speed over ground, and grown noise told.

The log of 6 s is of the model itself. Its file lacks the scale of 1.02, and has the noise of the
yaw rate thirteen times too small.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from concord.experiments.__main__ import main
from concord.features.vehicle.identification.sought import sought_of
from concord.features.vehicle.plant.drive_log import channels_of, read_log, write_drive
from concord.features.vehicle.plant.network import SIDE_SLIP, SPEED
from concord.features.vehicle.plant.parameters import car_from_toml
from concord.features.vehicle.plant.start import start_of
from tests.features.vehicle.identification.simulated_log import STEP_S, TRUE, simulated_log
from tests.features.vehicle.test_logged_positions import add

SCALE = 1.02
SHEETS = TRUE.sensors
CAR = replace(TRUE, sensors=replace(SHEETS, wheel_speed_scale=SCALE))
FILE = replace(
    TRUE, sensors=replace(SHEETS, yaw_rate=replace(SHEETS.yaw_rate, noise=0.0003))
)  # of 0.004


def written(folder: Path, seconds: float) -> None:
    """Write the log with a speed over ground."""
    drive, states = simulated_log(CAR, seconds, 3)
    write_drive(folder, drive, FILE)
    every = np.arange(0, len(states), 20)
    speed = states[every, SPEED] / np.cos(states[every, SIDE_SLIP])
    noise = SHEETS.ground_speed.noise * np.random.default_rng(4).standard_normal(len(every))
    add(folder, STEP_S * every, {"ground_speed": ("m/s", speed + noise)})


@pytest.mark.study
def test_the_scale_is_found_and_the_grown_noise_told(tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    written(tmp_path, 6.0)
    out = tmp_path / "found.toml"
    main(["identify-car", "--data", str(tmp_path), "--out", str(out)])
    said = capsys.readouterr().out
    row = re.search(r"scale of wheel speed +│ +(\S+) +│ (\S+) to (\S+) +│ 1 ", said)
    assert row, said
    value, low, high = (float(one) for one in row.groups())
    assert low <= SCALE <= high
    # The delay of the receiver, as uncertain, widens it where the car slows down.
    assert 1 < low < high < 1.04
    assert car_from_toml(out.read_text()).sensors.wheel_speed_scale == pytest.approx(
        value, rel=1e-3
    )
    grown = re.findall(r"^The (.*) is (\S+) times that of the file\.", said, re.MULTILINE)
    assert [name for name, _ in grown] == ["noise of yaw rate"]
    assert 10 < float(grown[0][1]) < 17


def test_without_a_speed_over_ground_no_scale_is_sought():
    channels = channels_of(simulated_log(CAR, 0.5, 1)[0])
    assert "scale of wheel speed" not in {
        one.name for one in sought_of(channels, CAR, friction=False, ratio=False)
    }


def test_filters_start_at_the_true_speed(tmp_path: Path):
    """Rear wheels alone tell the speed; they read too much by the scale of the file."""
    written(tmp_path, 0.5)
    channels, _ = read_log(tmp_path)
    wheels = {name: one for name, one in channels.items() if name != "speed"}
    for side in ("left", "right"):
        wheels[f"rear_{side}_wheel"] = wheels[f"front_{side}_wheel"]
    off = start_of(wheels, CAR.sensors).mean[SPEED] / start_of(wheels, SHEETS).mean[SPEED]
    assert off == pytest.approx(1 / SCALE, rel=1e-12)
