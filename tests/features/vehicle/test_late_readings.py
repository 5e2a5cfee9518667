"""`--arrival late`: readings come as late as a log's delays say, and the window puts them back.

Nodes get the readings of 0.64 s. Nothing is read in the last 60 ms, so that all have come.
"""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from concord.features.vehicle.plant.drive_log import channels_of, read_log
from concord.features.vehicle.plant.parameters import car_to_toml
from concord.plants.recorded.channels import ChannelReadings
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from tests.experiments.support import scenario
from tests.features.vehicle import test_recorded_rates
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log
from tests.test_batched_agreement import check_agreement

pytestmark = pytest.mark.slow

STEPS, QUIET_S = 140, 0.06
# By columns.toml the steering is 30 ms late; by car.toml the wheels 20 and the inertial unit 10.
LATE = (4, 2, 6, 0)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log whose lines stand in any order; only the truth goes on to the end."""
    channels = channels_of(simulated_log(TRUE, 0.7, 4)[0])
    channels.pop("speed")
    end_s = 0.7 - QUIET_S
    read = {
        name: one
        if name == "side_slip"
        else ChannelReadings(*(v[one.stamps_s < end_s] for v in one))
        for name, one in channels.items()
    }
    steering = read["steering"]
    read["steering"] = steering._replace(stamps_s=steering.stamps_s + 0.03)
    read["speed"] = read["front_left_wheel"]
    test_recorded_rates.as_separate_files(tmp_path, read)
    columns = tmp_path / "columns.toml"
    text = columns.read_text().replace(
        'file = "steering.csv"', 'file = "steering.csv", delay_s = 0.03'
    )
    columns.write_text(text)
    (tmp_path / "car.toml").write_text(car_to_toml(TRUE))
    return tmp_path


def of_log(folder: Path, arrival: str = "late", **options) -> Scenario:
    usual = {"rule": "labelled", "filter": "ukf", "cluster": "fitted", "steps": STEPS}
    return scenario("vehicle-network", data=str(folder), arrival=arrival, **(usual | options))


def trace_of(asked: Scenario) -> Trace:
    setup = prepare(asked)
    return read_trace(setup, in_memory(setup))


def test_readings_are_late_as_both_files_say(log: Path):
    setup = prepare(of_log(log))
    assert definition_of(setup.scenario).late_steps(setup.scenario) == LATE
    assert "steering" in read_log(log).channels


def test_late_readings_give_in_the_end_the_estimate_of_readings_on_time(log: Path):
    """To 1e-9 once all have come; before that a node knows less than with readings on time."""
    on_time, late = (trace_of(of_log(log, arrival)) for arrival in ("stamped", "late"))
    np.testing.assert_allclose(late.mean[-1], on_time.mean[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(late.cov[-1], on_time.cov[-1], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(late.readings, on_time.readings)
    middle = slice(20, 100)
    assert np.abs(late.mean[middle] - on_time.mean[middle]).max() > 1e-3
    spread = np.linalg.slogdet(late.cov[middle])[1] - np.linalg.slogdet(on_time.cov[middle])[1]
    assert (spread > 0).all()


def test_drivers_agree_on_late_readings(log: Path):
    check_agreement(of_log(log, steps=30), (0,))


def test_a_delay_of_nothing_is_no_delay(log: Path):
    """The estimates are those of readings on time at every step."""
    sheets = {
        name: replace(getattr(TRUE.sensors, name), delay_s=0.0)
        for name in ("wheel_speed", "yaw_rate", "lateral_acceleration", "longitudinal_acceleration")
    }
    car = replace(TRUE, sensors=replace(TRUE.sensors, **sheets))
    (log / "car.toml").write_text(car_to_toml(car))
    columns = log / "columns.toml"
    columns.write_text(columns.read_text().replace(", delay_s = 0.03", ""))
    on_time, late = (trace_of(of_log(log, a, steps=40)) for a in ("stamped", "late"))
    np.testing.assert_array_equal(late.mean, on_time.mean)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"data": None}, "this drive is simulated"),
        ({"rule": "ci"}, "rule ci has no window"),
        ({"window_steps": 6}, "up to 6 steps late, but the window has 6; use --window-steps"),
        ({"sensor_gate": 1e-6}, "leave --sensor-gate"),
    ],
)
def test_what_cannot_be_put_back_is_refused(log: Path, options: dict, says: str):
    with pytest.raises(ValueError, match=says):
        asked = {"data": str(log), "arrival": "late", "rule": "labelled", "filter": "ukf"}
        prepare(scenario("vehicle-network", cluster="fitted", steps=12, **(asked | options)))
