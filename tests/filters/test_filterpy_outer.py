"""filterpy's own tests of its unscented module, run over our functions.

The wheel of filterpy has no tests. `CONCORD_FILTERPY_TESTS` names the `kalman/tests/test_ukf.py` of
its repository; without it the first test is skipped. The second one needs only the wheel: it runs
the same filter in both, step by step.
"""

import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import filterpy.kalman
import numpy as np
import pytest

from tests.filters import filterpy_adapter

OUTER = os.environ.get("CONCORD_FILTERPY_TESTS", "")
NAMES = (
    "MerweScaledSigmaPoints", "JulierSigmaPoints", "SimplexSigmaPoints", "unscented_transform",
    "UnscentedKalmanFilter",
)  # fmt: skip


def outer_tests(monkeypatch: pytest.MonkeyPatch) -> list[FunctionType]:
    """filterpy's test functions, whose imports from filterpy.kalman find the adapter."""
    adapted = ModuleType("filterpy.kalman")
    vars(adapted).update(vars(filterpy.kalman))
    vars(adapted).update({name: getattr(filterpy_adapter, name) for name in NAMES})
    monkeypatch.setitem(sys.modules, "filterpy.kalman", adapted)
    outer: dict[str, Any] = {"__name__": "outer"}
    exec(compile(Path(OUTER).read_text(), OUTER, "exec"), outer)
    return [one for name, one in outer.items() if name.startswith("test_")]


@pytest.mark.skipif(not OUTER, reason="CONCORD_FILTERPY_TESTS names no test_ukf.py of filterpy")
def test_filterpys_unscented_tests_pass(monkeypatch: pytest.MonkeyPatch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = outer_tests(monkeypatch)
        assert len(found) >= 16
        for test in found:
            np.random.seed(1)  # filterpy's tests draw from the global generator
            test()


def step(x: np.ndarray, dt: float) -> np.ndarray:
    return x + dt * np.array([x[1], 0.0, 0.0])


def slant_range(x: np.ndarray) -> np.ndarray:
    return np.array([np.hypot(x[0], x[2])])


@pytest.mark.parametrize(
    "points",
    [
        lambda module: module.JulierSigmaPoints(n=3, kappa=0.0),
        lambda module: module.JulierSigmaPoints(n=3, kappa=1.0),
        lambda module: module.MerweScaledSigmaPoints(3, 0.5, 2.0, 0.0),
        lambda module: module.SimplexSigmaPoints(3),
    ],
)
def test_a_filter_and_a_smoother_give_the_numbers_of_filterpy(points: Callable[[Any], Any]):
    """Range to an aircraft. filterpy does not draw its points again before an update, so the
    process noise is zero here, where both are the same filter."""
    generator = np.random.default_rng(5)
    track = np.hypot(5.0 * np.arange(1, 41) + generator.normal(size=40), 1000.0)
    results = []
    for module in (filterpy.kalman, filterpy_adapter):
        made = module.UnscentedKalmanFilter(3, 1, 0.05, slant_range, step, points(module))
        made.x, made.P = np.array([0.0, 90.0, 1100.0]), 100.0 * np.eye(3)
        made.Q, made.R = np.zeros((3, 3)), np.array([[10.0]])
        means, covs = made.batch_filter(list(track[:, None]))
        smooth_means, smooth_covs, _ = made.rts_smoother(means, covs)
        results.append((means, covs, smooth_means, smooth_covs))
    for theirs, ours in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)
