import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete

from filters.discretisation import discretise, discretise_noise
from tests.filters.support import random_spd


@pytest.mark.parametrize("time_step_s", [1e-3, 0.1, 1.0])
@pytest.mark.parametrize(("n", "p"), [(1, 1), (3, 2), (4, 1)])
def test_zero_order_hold_is_that_of_scipy(n, p, time_step_s):
    generator = np.random.default_rng(n)
    A, B = generator.standard_normal((n, n)), generator.standard_normal((n, p))
    F, G = discretise(A, B, time_step_s)
    system = (A, B, np.eye(n), np.zeros((n, p)))
    expected: Any = cont2discrete(system, time_step_s, method="zoh")  # its type says object
    np.testing.assert_allclose(F, expected[0], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(G, expected[1], rtol=1e-11, atol=1e-12)


def test_two_half_steps_make_a_step():
    generator = np.random.default_rng(2)
    A, B = generator.standard_normal((3, 3)), generator.standard_normal((3, 1))
    W = random_spd(generator, (), 3)
    (F, G), Q = discretise(A, B, 0.4), discretise_noise(A, W, 0.4)
    (half_F, half_G), half_Q = discretise(A, B, 0.2), discretise_noise(A, W, 0.2)
    np.testing.assert_allclose(half_F @ half_F, F, rtol=1e-12)
    np.testing.assert_allclose(half_F @ half_G + half_G, G, rtol=1e-12)
    np.testing.assert_allclose(half_F @ half_Q @ half_F.T + half_Q, Q, rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_noise_is_the_integral(n):
    generator = np.random.default_rng(n)
    A, W, step = generator.standard_normal((n, n)), random_spd(generator, (), n), 0.5
    count = 2000
    midpoints = (np.arange(count) + 0.5) * step / count
    flows = expm(A * midpoints[:, None, None])
    riemann = (flows @ W @ flows.mT).sum(axis=0) * step / count
    # The midpoint rule errs by step^2 / count^2 / 24 of the second derivative.
    np.testing.assert_allclose(discretise_noise(A, W, step), riemann, rtol=1e-6, atol=1e-7)


def test_noise_of_a_double_integrator_is_that_of_the_textbook():
    A, W, t = np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, 0.05]), 2.0
    expected = 0.05 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
    np.testing.assert_allclose(discretise_noise(A, W, t), expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: discretise(np.eye(2), np.ones((2, 1)), 0.0), "time_step_s is 0.0"),
        (lambda: discretise(np.ones((2, 3)), np.ones((2, 1)), 1.0), r"A has shape \(2, 3\)"),
        (lambda: discretise(np.eye(2), np.ones(2), 1.0), r"B has shape \(2,\)"),
        (lambda: discretise_noise(np.eye(2), np.eye(3), 1.0), "noise density has shape"),
        (lambda: discretise_noise(np.eye(2), np.eye(2), -1.0), "time_step_s is -1.0"),
    ],
)
def test_what_does_not_fit_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_filters_load_without_scipy_and_networkx():
    """A node process imports numpy and our folders only."""
    code = (
        "import importlib, pkgutil, sys, filters\n"
        "for module in pkgutil.iter_modules(filters.__path__):\n"
        "    importlib.import_module(f'filters.{module.name}')\n"
        "sys.exit(sorted({'scipy', 'networkx'} & set(sys.modules)) or None)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
