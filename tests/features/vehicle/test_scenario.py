"""`vehicle-network`: together the car's sensors know more than each, in every driver alike."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.features.vehicle.plant.cars import FITTED_CARS
from concord.features.vehicle.plant.drive_log import write_drive
from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.network import SIDE_SLIP, SPEED, STATE_NAMES
from concord.features.vehicle.plant.parameters import ProcessNoise, SensorSheet, SensorSheets
from concord.filters.filter import LearningFilter
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured
from concord.results.bus.bus_report import figures_of
from concord.results.figures.network_errors import RunTruths, network_errors
from concord.results.figures.summary import heard_by_all
from concord.results.records.runs import runs_of_trace
from concord.results.records.runs_file import runs_arrays
from concord.results.records.trace import Trace, read_trace
from concord.results.verdict.judge import judged_innovations
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised, local_only
from concord.scenarios.build import build_node, filter_of
from concord.scenarios.catalogue import definition_named, scored_nees
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from tests.experiments.support import scenario
from tests.features.vehicle.test_vehicle_network import model_drive
from tests.test_batched_agreement import check_agreement

_NO_MODELS = importlib.util.find_spec("vehiclemodels") is None
pytestmark = [pytest.mark.skipif(_NO_MODELS, reason="needs the extra vehicle"), pytest.mark.slow]


def setup(**changes) -> Setup:
    return prepare(scenario("vehicle-network", **{"steps": 900, **changes}))


def run(prepared: Setup) -> Trace:
    return read_trace(prepared, in_memory(prepared))


def rmse(mean: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Per node and state (4, 6), from the second second on."""
    return np.sqrt(((mean[200:] - truth[200:, None]) ** 2).mean(axis=0))


@pytest.mark.parametrize("noise", ["matched", pytest.param("growing", marks=pytest.mark.study)])
def test_the_network_is_better_than_each_node_alone_in_every_state(noise):
    prepared = setup(noise=noise)
    trace = run(prepared)
    alone = rmse(local_only(prepared, trace.readings, None).mean, trace.truth)
    together = rmse(trace.mean, trace.truth)
    for state, name in enumerate(STATE_NAMES):
        assert together[:, state].max() < alone[:, state].min(), name


@pytest.mark.study
def test_estimates_are_consistent_while_the_noise_grows():
    """With the data sheets believed they are not: that is what learning is for."""
    nees = {}
    for filter in ("aukf", "ukf"):
        trace = run(setup(filter=filter, steps=1600, noise="growing"))
        error = (trace.mean - trace.truth[:, None])[900:]
        cov = trace.cov[900:]
        nees[filter] = float((error[..., None, :] @ np.linalg.inv(cov) @ error[..., None]).mean())
    assert nees["aukf"] < 6 * 1.3
    assert nees["aukf"] < 0.7 * nees["ukf"]


def test_the_bus_is_the_cars():
    prepared = setup(steps=4)
    figures = figures_of(runs_of_trace(prepared, run(prepared)))
    assert figures is not None
    assert figures.cycle_us == 5000
    assert prepared.time_step_s == pytest.approx(5e-3)
    # 27 numbers and what frames them, in frames of 34 bytes: 9 of them for each of 4 nodes.
    assert figures.frames_per_cycle_mean == 36
    assert 0.25 < figures.bus_load < 0.35


def test_a_node_process_knows_nothing_of_the_simulated_truth(tmp_path: Path):
    described = tmp_path / "setup.json"
    described.write_bytes(msgspec.json.encode(setup(steps=2)))
    code = (
        "import msgspec, sys; from pathlib import Path; "
        "from concord.scenarios.build import build_node; "
        "from concord.scenarios.setup import Setup; "
        f"build_node(msgspec.json.decode(Path({str(described)!r}).read_bytes(), type=Setup), 1); "
        "assert not {'vehiclemodels', 'concord.features.vehicle.plant.truth'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_log_takes_the_place_of_the_simulation(tmp_path: Path):
    from concord.features.vehicle.plant.truth import BMW, simulate

    drive = simulate(MANOEUVRES["serpentine"], BMW, 0.01, integration_step_s=5e-3)
    write_drive(tmp_path, drive, FITTED_CARS["bmw-320i"])
    prepared = setup(data=str(tmp_path), steps=1200)
    trace = run(prepared)
    np.testing.assert_allclose(trace.truth[:1200:2, SIDE_SLIP], drive.side_slip_rad[:600])
    known = np.isfinite(trace.truth[:, SIDE_SLIP])
    error = (trace.mean[..., SIDE_SLIP] - trace.truth[:, None, SIDE_SLIP])[known][100:]
    assert np.sqrt((error**2).mean()) < np.radians(0.15)


def test_the_noise_of_a_logged_slip_is_no_error_of_the_estimates(tmp_path: Path):
    """ANEES was 70 where the slip sensor was noisier than the estimates."""
    sheets = SensorSheets(side_slip=SensorSheet(noise=0.02))
    car = msgspec.structs.replace(FITTED_CARS["bmw-320i"], sensors=sheets)
    write_drive(tmp_path, model_drive(), car)
    rng = np.random.default_rng(3)
    spread = rng.standard_normal((4000, 6, 6))
    cov = 1e-4 * spread @ spread.mT
    error = rng.multivariate_normal(np.zeros(6), np.eye(6), 4000)
    error = np.einsum("kij,kj->ki", np.linalg.cholesky(cov), error)
    read = error - 0.02 * rng.standard_normal((4000, 1))
    logged, simulated = setup(steps=2, data=str(tmp_path)).scenario, setup(steps=2).scenario
    for drive, off in ((logged, read), (simulated, error)):
        assert abs(scored_nees(drive, off, cov).mean() - 1) < 4 * np.sqrt(2 / 4000)
    assert scored_nees(simulated, read, cov).mean() > 1.3


def test_steps_outside_the_model_are_not_judged_and_the_verdict_says_so():
    prepared = setup(steps=240, noise="matched")
    trace = run(prepared)
    runs = runs_of_trace(prepared, trace)
    heard = heard_by_all(runs)
    assert runs.innovations is not None and heard is not None
    nees = np.ones((1, 240))
    counted = np.arange(240)[None] >= 200
    whole, finding = judged_innovations(prepared, runs.innovations, heard, counted, nees)
    assert "not judged" not in finding.said
    heard.belief.mean[0, 230:, SPEED] = 2.0
    runs.innovations.value[0, 230:] *= 1e3
    part, finding = judged_innovations(prepared, runs.innovations, heard, counted, nees)
    assert part.outside is not None
    assert "not judged: 25 % of the drive, outside the model (below 3 m/s: 25 %" in finding.said
    assert part.outside["any"] == 0.25
    assert part.centralised.updates < whole.centralised.updates
    _, outside = runs_arrays(runs, heard=heard).variables["outside_model"]
    np.testing.assert_array_equal(outside[0], np.arange(240) >= 230)


def test_claims_are_judged_only_where_the_model_holds():
    prepared = setup(steps=240, noise="matched")
    trace = run(prepared)
    centre = centralised(prepared, trace.readings, trace.control)
    centre.mean[230:, SPEED] = 2.0
    known = RunTruths(trace.truth[None], trace.readings[None])
    nees = np.ones((1, 240, prepared.scenario.nodes))
    one_run = Gaussian(centre.mean[None], centre.cov[None])
    errors = network_errors(prepared, known, trace.mean[None], nees, one_run)
    for judged in (errors.nees[0, :, 0], errors.nees_centre[0]):
        np.testing.assert_array_equal(np.isnan(judged), np.arange(240) >= 230)
    assert np.isfinite(errors.nodes).all()


def test_process_noise_is_that_of_the_cars_file_times_the_option(tmp_path: Path):
    """The matrix is that of the filters in every driver; the usual one is what it always was."""
    usual = np.diag([1e-5, 5e-7, 1e-7, 1e-10, 0.0015**2, 0.02**2])
    definition = definition_named("vehicle-network")

    def noise_cov(**options) -> np.ndarray:
        return definition.model(setup(steps=2, **options).scenario).process_noise_cov(0)

    np.testing.assert_allclose(noise_cov(), usual, rtol=1e-12)
    np.testing.assert_allclose(noise_cov(process_noise=3.0), 9 * usual, rtol=1e-12)
    noise = ProcessNoise(side_slip_rad=0.3)
    car = msgspec.structs.replace(FITTED_CARS["bmw-320i"], process_noise=noise)
    write_drive(tmp_path, model_drive(), car)
    own = noise_cov(data=str(tmp_path), process_noise=2.0)
    assert own[SIDE_SLIP, SIDE_SLIP] == pytest.approx(0.005 * 0.6**2)
    assert own[0, 0] == pytest.approx(4e-5)


def test_drivers_agree_on_another_process_noise():
    options = {"steps": 12, "filter": "ukf"}
    check_agreement(scenario("vehicle-network", process_noise=4.0, **options), (0,))
    other = run(setup(process_noise=4.0, **options)).mean - run(setup(**options)).mean
    assert np.abs(other).max() > 1e-4


def test_nodes_learn_only_if_they_are_told_to():
    for options, learns in (({}, True), ({"filter": "ukf"}, False)):
        prepared = setup(steps=2, **options)
        assert isinstance(filter_of(prepared), LearningFilter) == learns
        estimator = build_node(prepared, 0).estimator
        content, _ = estimator.begin_step(estimator.start(), Measured(0, 0, [[20.0, 20.0, None]]))
        assert (content.memory != (None,)) == learns


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"manoeuvre": "drift"}, "Valid names are double-lane-change"),
        ({"noise": "paper"}, "Valid names are matched"),
        ({"nodes": 5}, "wheel speeds, inertial unit"),
        ({"steps": 5000}, "the drive has 2401 steps of 5 ms"),
        ({"rule": "labelled", "cluster": "fitted"}, "--filter aukf: .* use --filter ukf"),
        ({"cluster": "demo"}, "--stretch 2"),
        ({"data": "/nowhere"}, "no such folder"),
        ({"car": "lada"}, "Valid names are bmw-320i"),
        ({"process_noise": 0.0}, "process_noise 0.0: must be above 0"),
        ({"car": "bmw-320i-soft", "manoeuvre": "double-lane-change"}, "spins out"),
        ({"data": "here", "car": "vw-vanagon"}, "--car vw-vanagon: of simulated drives"),
    ],
)
def test_what_it_cannot_be_is_refused(changes: dict, says: str):
    with pytest.raises(ValueError, match=says):
        setup(**changes)


def test_all_steps_are_those_of_the_drive():
    definition = definition_named("vehicle-network")
    assert definition.all_steps is not None
    assert definition.all_steps(definition.defaults) == 2401
