"""Motions of own plants: inputs and steps, and what integrators do beside exact solutions."""

from functools import partial

import numpy as np
import pytest
import scipy.linalg
import xarray
from hypothesis import given
from hypothesis import strategies as st

from concord.plants.linear_systems import from_control
from concord.plants.own_motion import INTEGRATORS
from concord.plants.own_plant import OwnPlant

RATE = np.array([[0.0, 1.0], [-4.0, -0.4]])
FORCE = np.array([0.0, 2.0])
PLANT = partial(OwnPlant, Q=[1e-4, 1e-4], mean=[1.0, 0.0], cov=[1.0, 1.0], time_step_s=0.1)
STATES = np.array([[[1.0, 0.0], [0.5, -2.0], [0.0, 0.3]], [[0.1, 0.2], [3.0, 1.0], [-1.0, 1.0]]])


def exact(step_s: float, state: np.ndarray, force: float = 0.0) -> np.ndarray:
    """The states after a step of the linear system, by the exponential of its augmented matrix."""
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[:2, 2] = RATE, FORCE
    power = scipy.linalg.expm(step_s * augmented)
    return state @ power[:2, :2].T + force * power[:2, 2]


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_dynamics_are_solved_over_a_step(integrator: str):
    plant = PLANT(dynamics=lambda x: x @ RATE.T, integrator=integrator)
    close = 1e-4 if integrator == "rk4" else 1e-6
    np.testing.assert_allclose(plant.transition(STATES, None, 0), exact(0.1, STATES), atol=close)


@pytest.mark.parametrize("halvings", [1, 2, 3])
def test_an_rk4_step_errs_by_its_fifth_power(halvings: int):
    def error(step_s: float) -> float:
        plant = PLANT(dynamics=lambda x: x @ RATE.T, time_step_s=step_s)
        return np.abs(plant.transition(STATES, None, 0) - exact(step_s, STATES)).max()

    step_s = 0.4 / 2**halvings
    assert error(step_s) / error(step_s / 2) == pytest.approx(32, rel=0.15)


def test_a_stiff_system_needs_a_stiff_integrator():
    """x' = -1000 (x - cos t): rk4 is unstable at 0.1 s."""

    def stiff(x, u, t):
        return -1000 * (x - np.cos(t))

    plain, radau = (
        PLANT(dynamics=stiff, integrator=name, mean=[1.0], cov=[0.01], Q=[1e-6])
        for name in ("rk4", "Radau")
    )
    start = np.array([1.0])
    assert abs(plain.transition(start, None, 0)[0]) > 50
    assert radau.transition(start, None, 0)[0] == pytest.approx(np.cos(0.1), abs=1e-3)
    assert radau.transition(start, None, 7)[0] == pytest.approx(np.cos(0.8), abs=1e-3)


@given(st.integers(0, 9), st.floats(-5, 5))
def test_inputs_drive_the_step_that_they_belong_to(step: int, gain: float):
    inputs = gain * np.arange(10.0)
    forms = {
        "array": inputs,
        "column": inputs[:, None],
        "xarray": xarray.DataArray(inputs, dims="step"),
        "function": lambda k: gain * k,
    }
    for given_as in forms.values():
        f = PLANT(f=lambda x, u: x + u[0], inputs=given_as)
        np.testing.assert_allclose(f.transition(STATES, None, step), STATES + gain * step)
        held = PLANT(dynamics=lambda x, u: x @ RATE.T + FORCE * u[0], inputs=given_as)
        np.testing.assert_allclose(
            held.transition(STATES, None, step), exact(0.1, STATES, gain * step), atol=1e-3
        )


def test_a_step_comes_as_the_third_argument_also_without_inputs():
    plant = PLANT(f=lambda x, u, k: x + k + u.sum())
    np.testing.assert_allclose(plant.transition(STATES, None, 5), STATES + 5)


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({}, "f and dynamics: none given; give one"),
        ({"f": lambda x: x, "dynamics": lambda x: x}, "f and dynamics: both given"),
        ({"f": lambda x, u: x}, r"f\(x, u\) takes an input, and there is none; give inputs="),
        ({"f": lambda x: x, "inputs": [1.0]}, r"f\(x\) takes no input; write f\(x, u\)"),
        ({"f": lambda a, b, c, d: a}, r"f takes 4 arguments \(a, b, c, d\); write f\(x\)"),
        ({"dynamics": lambda: 0.0}, r"dynamics takes 0 arguments"),
        ({"f": 3}, "f of type int: must be a function"),
        ({"f": lambda x, u: x, "inputs": [1.0, np.nan]}, "entry 0 is nan at step 1"),
        ({"f": lambda x, u: x, "inputs": np.ones((2, 2, 2))}, r"must be \(steps, p\)"),
        ({"f": lambda x, u: x + u, "inputs": lambda k: [np.inf]}, r"inputs\(0\) is \[inf\]"),
        ({"f": lambda x: x, "integrator": "euler"}, "integrator 'euler': must be one of rk4"),
        ({"f": lambda x, u: x[0], "inputs": [1.0]}, r"f\(x, u\) with x of shape \(3, 2, 2\)"),
    ],
)
def test_a_motion_that_is_none_is_refused(fields: dict, says: str):
    with pytest.raises(ValueError, match=says):
        PLANT(**fields)


def test_a_linear_system_takes_inputs():
    control = pytest.importorskip("control")
    continuous = control.ss(RATE, FORCE[:, None], [[1.0, 0.0]], [[0.0]])
    noise = {"Q": [1e-4, 1e-4], "R": 0.01, "mean": [1, 0], "cov": [1, 1], "time_step_s": 0.1}
    plant, _ = from_control(continuous, **noise, inputs=np.arange(5.0))
    np.testing.assert_allclose(plant.transition(STATES, None, 3), exact(0.1, STATES, 3.0))
    free, _ = from_control(continuous, **noise)
    np.testing.assert_allclose(free.transition(STATES, None, 3), exact(0.1, STATES))
    with pytest.raises(ValueError, match="inputs: 2 for the 1 columns of B"):
        from_control(continuous, **noise, inputs=np.ones((5, 2)))
    through = control.ss(RATE, FORCE[:, None], [[1.0, 0.0]], [[1.0]])
    with pytest.raises(ValueError, match="D of the system is not 0"):
        from_control(through, **noise, inputs=np.ones(5))
