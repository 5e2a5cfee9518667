"""Functions of the user that fail: a rule before anything starts, any function in a run."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import concord as cc
from concord.disk import RunFailed
from concord.experiments.cli.command_line import main
from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.gaussian import Gaussian
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.user.faults import user_faults
from tests.processes import CONCORD

NETWORK = {"nodes": 4, "graph": "ring", "steps": 12}


def mean_of(beliefs: Gaussian, weights: np.ndarray) -> np.ndarray:
    return (weights[..., None] * beliefs.mean).sum(-2)


def fused(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    return covariance_intersection(beliefs, weights)


def raising(beliefs, weights):
    raise RuntimeError("my rule\nhas a fault")


def only_one_axis(beliefs, weights):
    mean, cov = fused(beliefs, weights)
    return Gaussian(mean, cov) if beliefs.mean.ndim < 5 else Gaussian(mean[0], cov[0])


@pytest.mark.parametrize(
    ("rule", "says"),
    [
        (lambda beliefs: beliefs, r"must take two arguments, rule\(beliefs, weights\)"),
        (raising, r"test_own_faults.py line \d+, in raising: RuntimeError: my rule has a fault"),
        (lambda beliefs, weights: None, r"returns a NoneType: must be Gaussian\(mean, cov\)"),
        (lambda beliefs, weights: beliefs, "returns the beliefs unfused"),
        (lambda b, w: Gaussian(mean_of(b, w), b.cov), r"mean \(2,\) and a covariance \(3, 2, 2\)"),
        (only_one_axis, r"means of shape \(2, 1, 3, 3, 2\) .*leading axes are free"),
        (lambda b, w: Gaussian(mean_of(b, w) + 0j, fused(b, w).cov), "a mean of complex128"),
        (
            lambda b, w: Gaussian(np.log(-(b.mean[..., 0, :] ** 2)), fused(b, w).cov),
            "mean with nan",
        ),
        (lambda b, w: Gaussian(mean_of(b, w), np.triu(fused(b, w).cov)), "not symmetric, by"),
        (lambda b, w: Gaussian(mean_of(b, w), 0 * b.cov[..., 0, :, :]), "eigenvalue of 0;"),
        (lambda b, w: fused(Gaussian(b.mean / b.mean.max(), b.cov), w), "mixes the lanes"),
    ],
)
def test_a_rule_that_is_none_is_refused_before_the_start(rule, says: str):
    with pytest.raises(ValueError, match=says):
        prepare(scenario_of("oscillator", rule=rule, **NETWORK))
    changes = ("5 set rule=tests.scenarios.test_own_faults:raising",)
    with pytest.raises(ValueError, match="has a fault"):
        prepare(scenario_of("oscillator", changes=changes, **NETWORK))


def test_a_sound_rule_and_one_of_several_models_pass():
    prepare(scenario_of("oscillator", rule=fused, **NETWORK))
    prepare(scenario_of("target-tracking", rule=fused, filter="imm", nodes=4, steps=5))


def test_the_command_refuses_a_rule_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["run", "--scenario", "oscillator", "--rule", f"{__file__}:raising"])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and "Traceback" not in said


LATE = """
import numpy as np
import concord as cc

def move(x):
    if np.max(x) > 1.5:
        raise KeyError("no road beyond 1.5")
    return x + 0.1

PLANT = cc.OwnPlant(f=move, Q=[1e-8], mean=[0.0], cov=[1e-6])
SCENARIO = cc.own_scenario(PLANT, [cc.OwnSensor(h=lambda x: x, R=0.1)], nodes=3, steps=40)

def late(beliefs, weights):
    mean = (weights[..., None] * beliefs.mean).sum(-2)
    if np.max(mean) > 1.0:
        return np.linalg.inv(np.zeros((2, 2)))
    return type(beliefs)(mean, beliefs.cov[..., 0, :, :])
"""


@pytest.mark.zenoh
@pytest.mark.parametrize("driver", ["in-process", "batched", "processes"])
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "late.py line 7, in move: KeyError: 'no road beyond 1.5'"),
        (("--rule", "FILE:late"), "late.py line 16, in late: LinAlgError: Singular matrix"),
    ],
)
def test_a_function_that_fails_in_a_run_is_named_with_its_line(
    driver: str, options: tuple[str, ...], says: str, tmp_path: Path
):
    file = tmp_path / "late.py"
    file.write_text(LATE)
    done = subprocess.run(
        [*CONCORD, "run", "--scenario", f"{file}:SCENARIO", "--driver", driver,
         *(word.replace("FILE", str(file)) for word in options)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert says in done.stderr and "Traceback" not in done.stderr


def test_in_python_the_exception_says_the_same(tmp_path: Path):
    file = tmp_path / "late.py"
    file.write_text(LATE)
    with pytest.raises(RunFailed, match=r"late\.py line 7, in move: KeyError") as failed:
        cc.simulate(cc.scenario(f"{file}:SCENARIO"))
    assert isinstance(failed.value.__cause__, KeyError)
    with pytest.raises(RunFailed, match=r"late\.py line 7, in move: KeyError"):
        cc.sweep(f"{file}:SCENARIO", rule=["ci"], runs=2)


def test_a_fault_of_ours_keeps_its_traceback():
    beliefs = Gaussian(np.zeros((2, 1)), np.ones((2, 1, 1)))
    with pytest.raises(ValueError, match="weights"), user_faults():
        covariance_intersection(beliefs, np.array([2.0, -1.0]))
