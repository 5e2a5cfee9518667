"""Satellite positions in a log: the state has the place of the car, and its estimate is right.

The logs are of the filters' own model, so that RMSE, NEES and NIS have known intervals.
"""

import csv
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from concord.experiments.__main__ import main
from concord.features.vehicle.plant.drive_log import (
    columns_from_toml,
    east_north,
    read_log,
    write_drive,
)
from concord.features.vehicle.plant.network import HEADING, PLACE, SIDE_SLIP, SPEED, YAW_RATE
from concord.features.vehicle.plant.parameters import Car, SensorSheet, car_to_toml
from concord.features.vehicle.plant.start import start_of
from concord.results.innovations.channel_test import nis_interval
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import innovations_of_all
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from tests.experiments.support import scenario
from tests.features.vehicle.identification.simulated_log import STEP_S, TRUE, simulated_log
from tests.test_batched_agreement import check_agreement

pytestmark = pytest.mark.slow

NOISE_M = 0.5
CAR = replace(TRUE, sensors=replace(TRUE.sensors, position=SensorSheet(noise=NOISE_M)))
PARIS = 0.8527, 0.0410
POSITION = ("position_x", "position_y")
EARLIER = round(TRUE.sensors.wheel_speed.delay_s / STEP_S)
"""Steps of a run before the first state of the simulation: the wheels' first stamp is late."""


def of_log(folder: Path, **options: Any) -> Scenario:
    """The network on a log; shares of eight states need more room than the car's bus has."""
    return scenario("vehicle-network", data=str(folder), filter="ukf", cluster="fitted", **options)


class Driven(NamedTuple):
    """States (steps, 8), and the fixes (n, 2) in m of every tenth of a second."""

    states: np.ndarray
    stamps_s: np.ndarray
    fixes: np.ndarray


def driven(folder: Path, seconds: float, seed: int, car: Car = CAR, turn: float = 0.7) -> Driven:
    """Write a log without positions whose car starts in a direction `turn`; return the rest."""
    drive, states = simulated_log(car, seconds, seed)
    states = states[:, :6]  # without the gusts
    write_drive(folder, drive, car)
    states[:, HEADING] += turn
    generator = np.random.default_rng(seed + 100)
    course = states[:, HEADING] + states[:, SIDE_SLIP]
    way = STEP_S * states[:, SPEED] / np.cos(states[:, SIDE_SLIP])
    moves = way[:, None] * np.stack([np.cos(course), np.sin(course)], axis=-1)
    moves += car.process_noise.position_m * np.sqrt(STEP_S) * generator.standard_normal(moves.shape)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)[:-1]])
    every = np.arange(0, len(states), 20)
    ahead = car.sensors.antenna_ahead_m * np.stack(
        [np.cos(states[every, HEADING]), np.sin(states[every, HEADING])], axis=-1
    )
    noise = car.sensors.position.noise * generator.standard_normal((len(every), 2))
    return Driven(
        np.concatenate([states, place], axis=1),
        STEP_S * every,
        place[every] + ahead + noise,
    )


def add(folder: Path, stamps_s: np.ndarray, columns: dict[str, tuple[str, np.ndarray]]) -> None:
    """Add the columns of a receiver, unit and values each, in a file of their own."""
    with (folder / "gnss.csv").open("w", newline="", encoding="utf-8") as file:
        rows = zip(stamps_s.tolist(), *(v.tolist() for _, v in columns.values()), strict=True)
        csv.writer(file).writerows([["t", *columns], *rows])
    with (folder / "columns.toml").open("a", encoding="utf-8") as file:
        file.writelines(
            f'{name} = {{ column = "{name}", unit = "{unit}", file = "gnss.csv", '
            'time = { column = "t", unit = "s" } }\n'
            for name, (unit, _) in columns.items()
        )


def metres(fixes: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    return {name: ("m", fixes[:, axis]) for axis, name in enumerate(POSITION)}


def on_the_globe(fixes: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    """Latitude and longitude of fixes by the radii of curvature, another formula than ours."""
    latitude, longitude = PARIS
    square = 0.00669437999014
    bent = 1 - square * np.sin(latitude) ** 2
    meridian, normal = 6378137 * (1 - square) / bent**1.5, 6378137 / np.sqrt(bent)
    from_first = fixes - fixes[0]
    return {
        "latitude": ("deg", np.degrees(latitude + from_first[:, 1] / meridian)),
        "longitude": (
            "deg",
            np.degrees(longitude + from_first[:, 0] / (normal * np.cos(latitude))),
        ),
    }


def test_the_plane_is_that_of_the_radii_of_curvature():
    fixes = np.array([[0.0, 0.0], [300.0, 0.0], [0.0, 300.0], [-200.0, 150.0]])
    globe = (np.radians(values) for _, values in on_the_globe(fixes).values())
    # The circle of latitude bends away from the plane by d^2 tan(latitude) / (2 R): 8 mm.
    np.testing.assert_allclose(np.stack(east_north(*globe), axis=-1), fixes, atol=0.01)


@pytest.mark.parametrize("written", [metres, on_the_globe])
def test_a_log_with_positions_has_a_place_that_nis_and_nees_confirm(written, tmp_path: Path):
    truth = driven(tmp_path, 6.0, 5)
    add(tmp_path, truth.stamps_s, written(truth.fixes))
    setup = prepare(of_log(tmp_path, steps=1190))
    plant: Any = definition_of(setup.scenario).plant(setup.scenario)
    assert plant.state_names[PLACE] == ("x", "y")
    heard = innovations_of_all(setup, [0], plant.exact[None, :1190], None)
    assert heard is not None
    nis = heard.innovations.nis[0, 200:]
    count = int(np.isfinite(heard.innovations.value[0, 200:]).sum())
    found = nis_interval(float(np.nansum(nis)), count)
    assert found.low < 1 < found.high
    error = heard.belief.mean[0, EARLIER:, PLACE] - truth.states[: 1190 - EARLIER, PLACE]
    if written is on_the_globe:
        error += truth.fixes[0]  # the plane touches the globe at the first fix
    # Ten fixes a second: the error is below that of one, and as large as the filter believes.
    assert np.sqrt((error[400:] ** 2).mean()) < 0.6 * NOISE_M


def test_the_places_of_many_drives_have_the_spread_that_the_filter_believes(tmp_path: Path):
    """The last place of each of 24 drives: independent, so that chi-square holds."""
    nees, found = [], []
    for seed in range(24):
        folder = tmp_path / str(seed)
        folder.mkdir()
        truth = driven(folder, 1.2, seed, turn=float(seed))
        add(folder, truth.stamps_s, metres(truth.fixes))
        setup = prepare(of_log(folder, steps=230))
        plant: Any = definition_of(setup.scenario).plant(setup.scenario)
        heard = innovations_of_all(setup, [0], plant.exact[None, :230], None)
        assert heard is not None
        error = heard.belief.mean[0, -1, PLACE] - truth.states[229 - EARLIER, PLACE]
        cov = heard.belief.cov[0, -1, PLACE, PLACE]
        nees.append(float(error @ np.linalg.solve(cov, error)))
        found.append(error)
    spread = nis_interval(sum(nees), 2 * len(nees))
    assert spread.low < 1 < spread.high
    assert np.sqrt(np.mean(np.square(found))) < 0.6 * NOISE_M


def test_a_receiver_that_tells_the_place_alone_fixes_the_heading(tmp_path: Path):
    """No course is logged: the first way gives the direction to a fifth, positions the rest."""
    truth = driven(tmp_path, 6.0, 8, turn=-2.5)
    add(tmp_path, truth.stamps_s, metres(truth.fixes))
    channels, car = read_log(tmp_path)
    start = start_of(channels, car.sensors)
    assert abs(start.mean[HEADING] + 2.5) < 3 * start.std[HEADING] < 1.0
    setup = prepare(of_log(tmp_path, steps=1190))
    mean = read_trace(setup, in_memory(setup)).mean
    error = mean[1000:, :, HEADING] - truth.states[1000 - EARLIER : 1190 - EARLIER, None, HEADING]
    assert np.abs(error).max() < 0.03
    place = mean[1000:, :, PLACE] - truth.states[1000 - EARLIER : 1190 - EARLIER, None, PLACE]
    assert np.sqrt((place**2).mean()) < 0.6 * NOISE_M


def test_drivers_agree_on_a_place(tmp_path: Path):
    truth = driven(tmp_path, 0.6, 2)
    add(tmp_path, truth.stamps_s, metres(truth.fixes))
    check_agreement(of_log(tmp_path, steps=12), (0,))


def test_a_course_that_counts_from_elsewhere_is_refused(tmp_path: Path):
    truth = driven(tmp_path, 3.0, 2, turn=2.5)
    course = truth.states[::20, HEADING] + truth.states[::20, SIDE_SLIP]
    compass = np.degrees(np.pi / 2 - course)
    add(tmp_path, truth.stamps_s, metres(truth.fixes) | {"course": ("deg", compass)})
    with pytest.raises(ValueError, match="a compass course needs scale = -1"):
        prepare(of_log(tmp_path, steps=12))
    columns = tmp_path / "columns.toml"
    columns.write_text(
        columns.read_text().replace(
            'column = "course",', 'column = "course", scale = -1.0, offset = 1.5708,'
        )
    )
    prepare(of_log(tmp_path, steps=12))


@pytest.mark.study
def test_the_command_judges_such_a_log_and_identifies_its_receiver(tmp_path: Path, capsys):
    """Antenna 1.5 m ahead, fixes twice as noisy as the file says and 40 ms late."""
    log = tmp_path / "log"
    log.mkdir()
    sheets = replace(CAR.sensors, antenna_ahead_m=1.5)
    truth = driven(log, 8.0, 3, replace(CAR, sensors=sheets))
    course = truth.states[::20, HEADING] + np.arctan2(
        truth.states[::20, SPEED] * np.tan(truth.states[::20, SIDE_SLIP])
        + 1.5 * truth.states[::20, YAW_RATE],
        truth.states[::20, SPEED],
    )
    course += 0.003 * np.random.default_rng(3).standard_normal(len(course))
    received = metres(truth.fixes) | {"course": ("rad", course)}
    add(log, truth.stamps_s + 0.04, received)
    wrong = replace(sheets, position=SensorSheet(noise=NOISE_M / 2))
    (log / "car.toml").write_text(car_to_toml(replace(CAR, sensors=wrong)))
    car = tmp_path / "car.toml"
    main(["identify-car", "--data", str(log), "--out", str(car), "--json"])
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["parameters"]}
    true = {"noise of position": NOISE_M, "delay of satellite receiver": 0.04}
    for name, value in true.items():
        assert found[name]["low"] < value < found[name]["high"], (name, found[name])
    (log / "car.toml").write_text(car.read_text())
    main(["run", "--scenario", "vehicle-network", "--data", str(log), "--number", "float32",
          "--filter", "ukf", "--out", str(tmp_path / "run")])  # fmt: skip
    said = " ".join(capsys.readouterr().out.split())
    assert "honesty consistent: models and sensors fit the readings" in said
    assert "the side slip errs as the filter that hears everything claims" in said


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (("latitude",), "only latitude; name latitude and longitude"),
        (("position_y",), "only position_y; name position_x and position_y"),
        (("latitude", "longitude", "position_x", "position_y"), "one of the two pairs"),
    ],
)
def test_half_a_position_is_refused(lines: tuple[str, ...], says: str):
    needed = 'yaw_rate = { column = "r", unit = "rad/s" }\n'
    needed += 'steering = { column = "d", unit = "rad" }\nspeed = { column = "v", unit = "m/s" }\n'
    units = {"latitude": "deg", "longitude": "deg"}
    extra = "".join(
        f'{name} = {{ column = "{name}", unit = "{units.get(name, "m")}" }}\n' for name in lines
    )
    with pytest.raises(ValueError, match=says):
        columns_from_toml(needed + extra)


def test_a_fix_with_half_its_numbers_is_refused(tmp_path: Path):
    truth = driven(tmp_path, 0.6, 2)
    columns = on_the_globe(truth.fixes)
    columns["longitude"][1][1] = np.nan
    add(tmp_path, truth.stamps_s, columns)
    with pytest.raises(ValueError, match="a fix has both"):
        read_log(tmp_path)
