"""One erratum at a time, and the bound, against what other ways of computing them say."""

import numpy as np
import pytest

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.measurement_bus import flexray
from concord.papers.meng2025 import posterior_bound
from concord.papers.meng2025.ablation import ablations
from concord.papers.meng2025.posterior_bound import bound_of
from concord.papers.meng2025.runs import carry_out, methods, simulate, transmit
from concord.papers.meng2025.table import mse_by_step, row, running_mse

pytestmark = pytest.mark.slow

BATCH = simulate(seed=4, runs=60, steps=40)
REFERENCE = carry_out(BATCH, methods()["recommended"])


def test_each_erratum_costs_what_an_independent_study_found():
    # Signs and orders of magnitude of the differences of MSE: spec of the paper, section 3.
    found = {
        name: row(name, "", BATCH, carry_out(BATCH, method), REFERENCE).difference
        for name, method in ablations().items()
    }
    low = {"erratum 2": 0.5, "erratum 4": 0.004, "erratum 10, h": 0.02, "erratum 10, f": 0.01}
    for name, least in low.items():
        one = found[name]
        assert one is not None and one.low > 0 and one.value > least
    rough = found["erratum 6"]
    assert rough is not None and abs(rough.value) < 0.002


def test_the_bound_of_a_linear_normal_system_is_the_kalman_covariance(
    monkeypatch: pytest.MonkeyPatch,
):
    """With g and b taken away, and h linear, the recursion is that of the information filter."""
    C = np.array([[1.0, 0.5]])

    class Linear:
        transition = staticmethod(meng2025.transition)
        measure = staticmethod(lambda state, step: state @ C.T)
        process_noise_cov = staticmethod(lambda step: 0.05 * np.eye(2))
        measurement_noise_cov = staticmethod(lambda step: 0.01 * np.eye(1))
        process_moment = staticmethod(lambda step: _none(2))
        measurement_moment = staticmethod(lambda step: _none(1))

    monkeypatch.setattr(posterior_bound, "SYSTEM", Linear)
    fresh = np.ones((40, BATCH.runs, 1), dtype=bool)
    fresh[5::3] = False
    found = bound_of(BATCH, fresh)
    cov = np.eye(2)
    for step in range(1, 41):
        A = meng2025.transition(np.eye(2), None, step - 1).T
        cov = A @ cov @ A.T + 0.05 * np.eye(2)
        if fresh[step - 1, 0, 0]:
            gain = cov @ C.T / (C @ cov @ C.T + 0.01)
            cov = cov - gain @ C @ cov
        np.testing.assert_allclose(found[step - 1], np.diag(cov), rtol=1e-6)


def _none(size: int):
    return posterior_bound.NoiseSecondMoment(np.zeros((1, size, size)), np.zeros((1, 2, 2)))


def test_no_filter_is_below_the_bound():
    fresh = transmit(BATCH, flexray(6, meng2025.STATIC_SLOTS)).fresh
    least = bound_of(BATCH, fresh).sum(axis=-1).mean()
    assert least < mse_by_step(BATCH, REFERENCE)[1:].mean()
    everything = bound_of(BATCH, np.ones_like(fresh)).sum(axis=-1).mean()
    assert everything < 0.5 * least


def test_the_running_error_is_the_mean_of_all_steps_so_far():
    running = running_mse(BATCH, REFERENCE, run=3)
    squared = ((REFERENCE.mean[1:, 3] - BATCH.truth[1:, 3]) ** 2).sum(-1)
    np.testing.assert_allclose(running[[0, 9, 39]], [squared[:n].mean() for n in (1, 10, 40)])
