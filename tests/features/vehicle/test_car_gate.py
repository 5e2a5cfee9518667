"""`--sensor-gate`: one finite reading of 1e8 in a log of a car changes nothing that follows."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from concord.features.vehicle.plant.drive_log import write_drive
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log

SPEED, WILD_STEP = 2, 20


def estimates(folder: Path, wild: bool, **options) -> np.ndarray:
    """Speeds (steps, 4) of the nodes; the two first steps of a log are those of delays."""
    drive, _ = simulated_log(TRUE, 0.5, 1)
    if wild:
        drive.wheel_speed_m_s[WILD_STEP, 0] = 1e8
    folder.mkdir(exist_ok=True)
    write_drive(folder, drive, TRUE)
    setup = prepare(scenario("vehicle-network", data=str(folder), steps=60, **options))
    return read_trace(setup, in_memory(setup)).mean[..., SPEED]


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")  # of what no gate refuses
@pytest.mark.parametrize("filter", ["ukf", "aukf", "ekf"])
def test_one_wild_reading_changes_nothing_that_follows(filter: str, tmp_path: Path):
    gated = {"filter": filter, "sensor_gate": 1e-6}
    clean = estimates(tmp_path / "clean", False, **gated)
    wild = estimates(tmp_path / "wild", True, **gated)
    assert np.isfinite(wild).all()
    # The reading that was refused is missing, and an adaptive filter doubts its sensor.
    assert np.abs(wild - clean).max() < 0.1
    without = estimates(tmp_path / "wild", True, filter=filter)
    assert not np.nanmax(np.abs(without - clean)) < 10


def test_the_gate_is_the_quantile_of_each_sensor(tmp_path: Path):
    write_drive(tmp_path, simulated_log(TRUE, 0.5, 1)[0], TRUE)

    def gates(**options) -> list[float | None]:
        chosen = scenario("vehicle-network", data=str(tmp_path), steps=2, **options)
        sensors = (definition_of(chosen).sensor(chosen, node) for node in range(4))
        return [None if one is None else one.gate for one in sensors]

    assert gates() == [None] * 4
    expected = chi2.isf(1e-3, [2, 3, 1, 2])
    np.testing.assert_allclose(np.array(gates(sensor_gate=1e-3), dtype=float), expected)
