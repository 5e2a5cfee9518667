"""How sensors err, in distribution."""

import numpy as np
import pytest

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.sensors import (
    TEST_CAR,
    SensorError,
    contaminated,
    draw_errors,
    logged,
    noise_std,
)

TIME_S = np.arange(0, 10, 0.01)


def draw(error: SensorError, seed: int = 1) -> np.ndarray:
    return draw_errors(error, np.random.default_rng(seed), TIME_S, 50)


def test_noise_and_bias_are_what_they_say():
    errors = draw(SensorError(0.2, bias=0.7))
    # 50000 draws: the mean within 4 and the deviation within 3 of their own deviations.
    assert abs(errors.mean() - 0.7) < 4 * 0.2 / np.sqrt(errors.size)
    assert abs(errors.std() / 0.2 - 1) < 3 / np.sqrt(2 * errors.size)


def test_noise_grows_when_it_is_said_to():
    error = SensorError(0.1, changes=((2.0, 3.0), (6.0, 0.5)))
    std = noise_std(error, TIME_S)
    np.testing.assert_allclose(std[[0, 199, 200, 599, 600, -1]], [0.1, 0.1, 0.3, 0.3, 0.05, 0.05])
    found = draw(error).std(axis=1)
    np.testing.assert_allclose(found[200:600].mean() / found[:200].mean(), 3.0, rtol=0.05)


def test_outliers_are_a_share_and_leave_the_others_alone():
    quiet = contaminated(SensorError(1.0), np.random.default_rng(3), (100_000,))
    wild = contaminated(
        SensorError(1.0, outlier_share=0.02, outlier_scale=20.0),
        np.random.default_rng(3),
        (100_000,),
    )
    changed = wild != quiet
    assert abs(changed.mean() - 0.02) < 4 * np.sqrt(0.02 * 0.98 / 1e5)
    np.testing.assert_allclose(wild[changed], 20 * quiet[changed])


def test_the_first_runs_do_not_depend_on_how_many_there_are():
    error = SensorError(1.0)
    few = draw_errors(error, np.random.default_rng(1), TIME_S, 3)
    np.testing.assert_array_equal(few, draw(error)[:, :3])


def test_a_logged_drive_errs_as_its_sensors_do():
    steps = 4000
    values = {name: np.full(steps, float(i)) for i, name in enumerate(Drive._fields[1:])}
    exact = Drive(0.01, **values)._replace(wheel_speed_m_s=np.zeros((steps, 4)))
    errors = {"speed_m_s": SensorError(0.2, bias=0.5), "wheel_speed_m_s": SensorError(0.1)}
    drive = logged(exact, errors, np.random.default_rng(5))
    speed = drive.speed_m_s - exact.speed_m_s
    # 4000 draws: four of their own deviations.
    assert speed.mean() == pytest.approx(0.5, abs=4 * 0.2 / np.sqrt(steps))
    assert speed.std() == pytest.approx(0.2, rel=4 / np.sqrt(2 * steps))
    np.testing.assert_allclose(drive.wheel_speed_m_s.std(axis=0), 0.1, rtol=0.05)
    correlation = np.corrcoef(drive.wheel_speed_m_s.T) - np.eye(4)
    assert np.abs(correlation).max() < 4 / np.sqrt(steps)
    for field in set(Drive._fields) - set(errors):
        assert getattr(drive, field) is getattr(exact, field)
    assert set(TEST_CAR) < set(Drive._fields)
