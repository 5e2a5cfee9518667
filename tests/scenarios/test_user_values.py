"""Values of the user's own files: equal to ours where they say the same, and refused by name."""

import os
import sys
from pathlib import Path

import msgspec
import networkx
import numpy as np
import pytest

from concord.experiments.python_studies import sweep
from concord.filters.fusion import averaging
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, Residual
from concord.filters.update import Update, condition
from concord.plants.oscillator import POSITION, VELOCITY, Oscillation
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.results.folder import from_copies, keep_copies
from concord.scenarios.definitions.own import own_scenario, portable
from concord.scenarios.preparation import fingerprint, prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.types.assignment import flat
from concord.scenarios.user.values import is_source_name, source_of, value_of
from concord.studies.agree import agreement
from concord.studies.monte_carlo.simulate import simulate

MODEL = Oscillation()


def rule(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """The rule `wac` again: weighted means of means and covariances."""
    share = weights / weights.sum(axis=-1, keepdims=True)
    heard = share[..., None] > 0
    mean = (share[..., None] * np.where(heard, beliefs.mean, 0)).sum(axis=-2)
    covs = np.where(heard[..., None], beliefs.cov, 0)
    return Gaussian(mean, (share[..., None, None] * covs).sum(axis=-3))


def oscillator() -> Scenario:
    plant = OwnPlant(
        f=lambda x: x @ MODEL.transition_matrix.T,
        Q=MODEL.process_noise_cov(0),
        mean=[0, 0],
        cov=MODEL.stationary_cov,
        time_step_s=MODEL.time_step_s,
        state_names=("x", "vx"),
        state_units=("m", "m/s"),
    )
    place = OwnSensor(h=lambda x: x[..., :1], R=POSITION.noise_std**2)
    speed = OwnSensor(h=lambda x: x[..., 1:], R=VELOCITY.noise_std**2)
    return own_scenario(plant, [place, speed, place, None], nodes=8)


OWN = oscillator()


def test_an_own_oscillator_has_the_numbers_of_ours():
    """Noise may be drawn along other axes, so that only what depends on no draw is equal."""
    ours, own = (
        simulate(prepare(one.with_(steps=30, hold="predict")), range(2))
        for one in (scenario_of("oscillator"), OWN)
    )
    np.testing.assert_allclose(own.cov_trace, ours.cov_trace, rtol=1e-9)


@pytest.mark.zenoh
def test_own_plant_and_rule_agree_in_every_driver():
    asked = portable(OWN.with_(rule=rule, steps=15, nodes=5, occupancy=0.4))
    found = agreement(prepare(asked))
    assert found.near and found.differences == ()


def test_an_own_arbiter_agrees_in_every_driver_and_is_kept(tmp_path: Path):
    file = write(tmp_path, "def urgency(state, bids, frame_ids):\n    return -bids")
    bus = {"schedule": "dynamic", "occupancy": 0.4, "steps": 12, "nodes": 5}
    own = prepare(scenario_of("oscillator", arbiter=f"{file}:urgency", **bus))
    ours = prepare(scenario_of("oscillator", arbiter="wtod", **bus))
    digest = source_of(f"{file}:urgency").digest
    assert flat(own.scenario)["arbiter"] == f"{file}:urgency#{digest}"
    found = agreement(own)
    assert found.near and found.differences == ()
    np.testing.assert_array_equal(simulate(own, [0]).asked, simulate(ours, [0]).asked)
    np.testing.assert_array_equal(simulate(own, [0]).mean, simulate(ours, [0]).mean)
    keep_copies(tmp_path, own.scenario)
    write(tmp_path, "urgency = 'no function'")
    with pytest.raises(ValueError, match="digest"):
        prepare(own.scenario)
    assert prepare(from_copies(tmp_path, own.scenario)).neighbours == own.neighbours
    with pytest.raises(ValueError, match="must be a function urgency"):
        prepare(scenario_of("oscillator", arbiter=f"{file}:urgency", **bus))


def test_graphs_are_taken_as_values():
    ring = OWN.with_(graph=networkx.cycle_graph(5))
    assert ring.nodes == 5
    assert prepare(ring).neighbours == prepare(OWN.with_(nodes=5, graph="ring")).neighbours
    matrix = networkx.to_numpy_array(networkx.path_graph(4))
    assert prepare(OWN.with_(graph=matrix)).neighbours == [[1], [0, 2], [1, 3], [2]]


def write(folder: Path, text: str) -> str:
    (folder / "mine.py").write_text(text)
    return f"{folder}/mine.py"


def test_a_changed_file_is_refused_with_both_digests(tmp_path: Path):
    file = write(tmp_path, "def rule(beliefs, weights): return 1")
    source = source_of(f"{file}:rule")
    assert value_of(source)(1, 2) == 1
    write(tmp_path, "def rule(beliefs, weights): return 2")
    changed = source_of(f"{file}:rule")
    with pytest.raises(ValueError, match=f"{changed.digest}.*{source.digest}"):
        value_of(source)
    assert value_of(changed)(1, 2) == 2


def test_code_of_a_former_text_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Python keeps compiled code under the second of a file's last change and its length."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    file = tmp_path / "own.py"
    for value in (1, 2):
        file.write_text(f"VALUE = {value}\n")
        os.utime(file, (1e9, 1e9))
        assert value_of(source_of(f"{file}:VALUE")) == value


def test_the_digest_is_in_the_setup(tmp_path: Path):
    marks = []
    for line in ("", "# another file"):
        file = write(tmp_path, f"from tests.scenarios.test_user_values import rule\n{line}")
        marks.append(fingerprint(prepare(scenario_of("oscillator", rule=f"{file}:rule"))))
    assert marks[0] != marks[1]


@pytest.mark.parametrize(
    ("text", "name", "says"),
    [
        ("x = 1", "rule", "unknown name in .*mine.py 'rule'"),
        ("x = 1", "x", "it is a int; it must be a function"),
        ("x = 1\ny = 1 / 0", "x", "line 2: ZeroDivisionError: division by zero; correct the file"),
        ("x = (", "x", "SyntaxError"),
    ],
)
def test_a_file_that_cannot_serve_is_refused(tmp_path: Path, text: str, name: str, says: str):
    file = write(tmp_path, text)
    with pytest.raises(ValueError, match=says):
        prepare(scenario_of("oscillator", rule=f"{file}:{name}"))


def test_files_and_modules_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match=r"there is no file \./none\.py"):
        scenario_of("./none.py:SCENARIO")
    with pytest.raises(ValueError, match=r"there is no module none\.such"):
        scenario_of("oscillator", rule="none.such:rule")
    with pytest.raises(ValueError, match="must be a scenario"):
        scenario_of("tests.scenarios.test_user_values:rule")
    with pytest.raises(ValueError, match=r"own\.py' ?: a file is given with .* own\.py:NAME"):
        scenario_of("own.py")


def test_a_class_is_refused_as_a_rule_and_as_an_arbiter():
    place = "tests.scenarios.test_user_values:Kalman"
    with pytest.raises(ValueError, match="it is a type; it must be a function rule"):
        prepare(scenario_of("oscillator", rule=place))
    with pytest.raises(ValueError, match="it is a type; it must be a function"):
        prepare(scenario_of("oscillator", arbiter=place, occupancy=0.5))


def test_objects_of_a_session_go_to_other_processes_only_by_a_name():
    assert portable(OWN).name.endswith("test_user_values.py:OWN")
    with pytest.raises(ValueError, match="define it under a name at the top"):
        portable(oscillator())
    with pytest.raises(ValueError, match="define it under a name at the top"):
        portable(OWN.with_(rule=lambda beliefs, weights: averaging))


def test_a_run_folder_keeps_the_files(tmp_path: Path):
    file = write(tmp_path, "from tests.scenarios.test_user_values import OWN, rule")
    scenario = scenario_of(f"{file}:OWN", rule=f"{file}:rule")
    folder = tmp_path / "run"
    folder.mkdir()
    keep_copies(folder, scenario)
    write(tmp_path, "another = 'file'")
    travelled = msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario)
    with pytest.raises(ValueError, match="digest"):
        prepare(travelled)
    assert prepare(from_copies(folder, travelled)).scenario.nodes == 8


@pytest.mark.parametrize(
    "text", ["ring", "file:a.graphml", "bernoulli:0.1", "edges:0-1", "4-regular"]
)
def test_other_names_are_not_taken_for_files(text: str):
    assert not is_source_name(text)


# --- filters -------------------------------------------------------------------------------------


class Kalman:
    """The filter `kf` again, for the models of the oscillator alone."""

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        F = transition(np.eye(2)).T - transition(np.zeros((2, 2))).T
        return Gaussian(transition(belief.mean[None])[0], F @ belief.cov @ F.T + noise_cov)

    def update(
        self,
        belief: Gaussian,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> Update:
        lanes = belief.mean.shape[:-1]
        basis = np.eye(2).reshape(2, *(1,) * len(lanes), 2) + np.zeros((*lanes, 2))
        H = np.moveaxis(measure(basis), 0, -1)
        cross_cov = belief.cov @ H.mT
        cov = H @ cross_cov + noise_cov
        return condition(
            belief, measurement, measure(belief.mean[None])[0], cov, cross_cov, residual, gate
        )


KALMAN = Kalman()


@pytest.mark.parametrize(
    ("asked", "named"),
    [({"rule": rule}, {"rule": "wac"}), ({"filter": KALMAN}, {"filter": "kf"})],
    ids=["rule", "filter"],
)
def test_an_own_value_has_the_numbers_of_ours(asked: dict, named: dict):
    own, ours = (
        simulate(
            prepare(scenario_of("oscillator", steps=20, nodes=6, hold="drop", **one)), range(2)
        )
        for one in (asked, named)
    )
    np.testing.assert_allclose(own.mean, ours.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(own.cov_trace, ours.cov_trace, rtol=1e-9)


@pytest.mark.zenoh
@pytest.mark.parametrize("rule", ["ci", "labelled"])
def test_own_plant_and_filter_agree_in_every_driver(rule: str):
    asked = portable(OWN.with_(filter=KALMAN, rule=rule, steps=12, nodes=5))
    assert asked.filter.name.endswith("test_user_values.py:KALMAN")
    found = agreement(prepare(asked))
    assert found.near and found.differences == ()


def test_a_run_folder_keeps_the_filter(tmp_path: Path):
    file = write(tmp_path, "from tests.scenarios.test_user_values import KALMAN")
    scenario = scenario_of("oscillator", filter=f"{file}:KALMAN")
    keep_copies(tmp_path, scenario)
    write(tmp_path, "KALMAN = 'another'")
    with pytest.raises(ValueError, match="digest"):
        prepare(scenario)
    prepare(from_copies(tmp_path, scenario))
    with pytest.raises(ValueError, match="must be an object with the functions predict"):
        prepare(scenario_of("oscillator", filter=f"{file}:KALMAN"))


def test_a_sweep_takes_filters_by_name_and_as_objects():
    found = sweep("oscillator", runs=2, steps=10, nodes=4, filter=["kf", KALMAN])
    ours, own = found["rmse"].to_numpy()
    np.testing.assert_allclose(own, ours, rtol=1e-9)
