"""A log with one known error in the car's file: the verdict names it, and `identify` finds it.

Logs of 8 s of the model itself. Each file has the truth but for one value.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from concord.experiments.__main__ import main
from concord.features.vehicle.identification.likelihood import likelihood, values_at
from concord.features.vehicle.identification.logged_readings import logged_readings
from concord.features.vehicle.identification.sought import car_with, sought_of
from concord.features.vehicle.identification.suspects import suspect
from concord.features.vehicle.plant.drive_log import channels_of, write_drive
from concord.features.vehicle.plant.model import tanh_tyre
from concord.features.vehicle.plant.parameters import Car
from concord.results.figures.intervals import Interval, batch_means
from concord.results.verdict.judge import judged_innovations
from concord.scenarios.catalogue import definition_of, scored_nees
from concord.scenarios.innovations import innovations_of_all
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log

pytestmark = pytest.mark.slow

SECONDS, SEED, STEPS = 8.0, 3, 1580
SENSORS = TRUE.sensors
INERTIAL = ("yaw_rate", "lateral_acceleration", "longitudinal_acceleration")


def with_sheets(names: tuple[str, ...], **values: float) -> Car:
    sheets = {name: replace(getattr(SENSORS, name), **values) for name in names}
    return replace(TRUE, sensors=replace(SENSORS, **sheets))


class Planted(NamedTuple):
    file: Car
    name: str
    truth: float


NOISE = TRUE.process_noise
CAUSES = {
    "Q": Planted(
        replace(TRUE, process_noise=replace(NOISE, yaw_rate_rad_s=NOISE.yaw_rate_rad_s / 5)),
        "process noise of yaw rate",
        NOISE.yaw_rate_rad_s,
    ),
    "R": Planted(with_sheets(("yaw_rate",), noise=0.001), "noise of yaw rate", 0.004),
    "bias": Planted(with_sheets(("yaw_rate",), offset=-0.014), "offset of yaw rate", 0.006),
    "delay": Planted(with_sheets(INERTIAL, delay_s=0.03), "delay of inertial unit", 0.01),
    "lever arm": Planted(
        replace(TRUE, sensors=replace(SENSORS, accelerometer_ahead_m=-0.55)),
        "accelerometer ahead of the centre",
        0.45,
    ),
    "roll": Planted(
        replace(TRUE, sensors=replace(SENSORS, lateral_acceleration_scale=1.0)),
        "scale of lateral acceleration",
        1.05,
    ),
}

QUICK = ("R", "lever arm")
"""A noise, and a value that shifts readings; `make studies` plants the others."""


class Judged(NamedTuple):
    sentence: str
    nis: tuple[float, float]
    anees: Interval


def judged_log(folder: Path) -> Judged:
    """The verdict on the filter that hears everything, which believes the file."""
    setup = prepare(scenario("vehicle-network", data=str(folder), filter="ukf", steps=STEPS))
    plant: Any = definition_of(setup.scenario).plant(setup.scenario)
    heard = innovations_of_all(setup, [0], plant.exact[None, :STEPS], None)
    assert heard is not None
    error = heard.belief.mean[0] - plant.truth[:STEPS]
    squares = scored_nees(setup.scenario, error, heard.belief.cov[0])
    counted = np.arange(STEPS)[None] >= 200
    nees = np.ones((1, STEPS))
    figures, found = judged_innovations(setup, heard.innovations, heard, counted, nees)
    assert figures.centralised.interval is not None
    return Judged(found.said, figures.centralised.interval, batch_means(squares[200:]))


@pytest.mark.parametrize(
    "cause",
    [pytest.param(name, marks=[] if name in QUICK else pytest.mark.study) for name in CAUSES],
)
def test_the_verdict_names_it(cause: str, tmp_path: Path):
    drive, _ = simulated_log(TRUE, SECONDS, SEED)
    write_drive(tmp_path, drive, CAUSES[cause].file)
    said = judged_log(tmp_path).sentence
    assert f"of single values of car.toml, {CAUSES[cause].name} explains most: " in said
    assert f"`concord identify-car --data {tmp_path}` fits all" in said


@pytest.mark.study
@pytest.mark.parametrize("cause", ["Q", "lever arm"])
def test_identify_finds_it(cause: str, tmp_path: Path, capsys):
    """A noise, and a value that shifts readings; test_fit.py fits all values at once."""
    planted, before, after = CAUSES[cause], tmp_path / "before", tmp_path / "after"
    drive, _ = simulated_log(TRUE, SECONDS, SEED)
    before.mkdir()
    write_drive(before, drive, planted.file)
    out = tmp_path / "found.toml"
    main(["identify-car", "--data", str(before), "--out", str(out), "--json"])
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["parameters"]}
    assert found[planted.name]["low"] < planted.truth < found[planted.name]["high"]
    after.mkdir()
    write_drive(after, drive, planted.file)
    (after / "car.toml").write_text(out.read_text(encoding="utf-8"), encoding="utf-8")
    found_right = judged_log(after)
    assert "explains most" not in found_right.sentence
    assert found_right.nis[0] < 1 < found_right.nis[1]
    # The logged side slip stands for the truth.
    assert found_right.anees.low < 1 < found_right.anees.high


def test_nothing_is_named_where_the_file_is_right():
    """Of five logs; the threshold allows one in a hundred."""
    named = []
    for seed in range(10, 15):
        channels = channels_of(simulated_log(TRUE, 3.0, seed)[0])
        log = logged_readings(channels, TRUE, 0.005, 3.0)
        every = sought_of(channels, TRUE, friction=False, ratio=False)
        found = suspect(log, TRUE, tanh_tyre, every)
        named += [] if found is None else [found.sought.name]
    assert len(named) <= 1, named


def test_lanes_of_cars_are_likely_as_each_car_alone():
    channels = channels_of(simulated_log(TRUE, 1.5, 2)[0])
    log = logged_readings(channels, TRUE, 0.005, 3.0)
    every = sought_of(channels, TRUE, friction=False, ratio=False)

    spreads = 0.1 * np.random.default_rng(1).standard_normal((3, len(every)))
    spreads[:, [one.is_delay for one in every]] = 0.0
    together = values_at(log, tanh_tyre, every, spreads)
    alone = [
        likelihood(
            dataclasses.replace(log, car=car_with(TRUE, every, one)),
            tanh_tyre,
            every,
            0 * one,
            np.ones(len(every)),
        ).value
        for one in spreads
    ]
    np.testing.assert_allclose(together, alone, rtol=1e-9)
