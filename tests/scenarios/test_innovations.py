"""Test innovations: those that nodes compute, those of formulas, and those of the best filter."""

from collections.abc import Callable

import numpy as np
import pytest

from concord.filters.gaussian import Gaussian
from concord.nodes.rules import local_filter
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised
from concord.scenarios.innovations import (
    Innovations,
    innovations_of_all,
    innovations_of_nodes,
)
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.support import small


def of_trace(setup: Setup, trace: Trace) -> Innovations:
    control = None if trace.control is None else trace.control[None]
    belief = Gaussian(trace.mean[None], trace.cov[None])
    found = innovations_of_nodes(setup, [0], belief, trace.readings[None], control)
    assert found is not None
    return Innovations(*(values[0] for values in found))


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch):
    """Run a setup, and return its trace with all updates that its nodes made."""

    def run(setup: Setup) -> tuple[Trace, list]:
        made: list = []
        update: Callable = local_filter.update_and_learn

        def watch(*arguments, **named):
            result, memory = update(*arguments, **named)
            made.append(result)
            return result, memory

        with monkeypatch.context() as patched:
            patched.setattr(local_filter, "update_and_learn", watch)
            trace = read_trace(setup, in_memory(setup))
        return trace, made

    return run


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("oscillator", {"steps": 20, "rule": "ci"}),
        ("oscillator", {"steps": 20, "rule": "hcmci", "occupancy": 0.5}),
        ("oscillator", {"steps": 20, "rule": "kcf"}),
        ("target-tracking", {"steps": 20, "nodes": 6, "filter": "ckf"}),
        ("dc-motor-speed", {"steps": 20}),
        ("vehicle-network", {"steps": 120}),
        ("vehicle-network", {"steps": 60, "filter": "ukf"}),
        ("vehicle-network", {"steps": 60, "filter": "aukf"}),
    ],
)
def test_innovations_are_those_that_the_nodes_computed(watched, name: str, options: dict):
    setup = small(name, **options)
    trace, made = watched(setup)
    found = of_trace(setup, trace)
    told = np.sort([v for one in made for v in one.innovation[np.isfinite(one.innovation)]])
    np.testing.assert_allclose(np.sort(found.value[np.isfinite(found.value)]), told, atol=1e-12)
    squares = np.sort([float(one.normalised_innovation_squared) for one in made])
    np.testing.assert_allclose(np.sort(found.nis[np.isfinite(found.nis)]), squares, rtol=1e-7)
    assert len(told) > 20


@pytest.mark.parametrize("rule", ["ci", "labelled"])
def test_innovations_are_those_of_the_formulas(rule: str):
    """On a linear plant: y - H F m, with covariance H (F P F' + Q) H' + R."""
    setup = small(steps=15, rule=rule)
    trace = read_trace(setup, in_memory(setup))
    found = of_trace(setup, trace)
    from concord.plants.oscillator import Oscillation

    model = Oscillation(time_step_s=setup.time_step_s)
    move, noise_cov = model.transition_matrix, model.process_noise_cov(0)
    rows = {0: [1.0, 0.0], 1: [0.0, 1.0], 2: [1.0, 0.0]}
    for step in range(1, 15):
        for node, row in rows.items():
            before = move @ trace.mean[step - 1, node]
            cov = move @ trace.cov[step - 1, node] @ move.T + noise_cov
            expected = trace.readings[step, node, 0, 0] - np.array(row) @ before
            variance = np.array(row) @ cov @ np.array(row) + 0.25
            assert found.value[step, node, 0, 0] == pytest.approx(expected, abs=1e-10)
            assert found.cov[step, node, 0, 0, 0] == pytest.approx(variance, rel=1e-10)
            assert found.nis[step, node, 0] == pytest.approx(expected**2 / variance, rel=1e-9)
    assert np.isnan(found.value[:, 3]).all()  # a blind node


@pytest.mark.parametrize("name", ["oscillator", "target-tracking", "vehicle-network"])
def test_the_filter_that_hears_everything_is_that_of_the_baseline(name: str):
    setup = small(name, **({"steps": 250} if name == "vehicle-network" else {}))
    trace = read_trace(setup, in_memory(setup))
    found = innovations_of_all(setup, [0], trace.readings[None], None)
    assert found is not None
    expected = centralised(setup, trace.readings, trace.control)
    np.testing.assert_allclose(found.belief.mean[0], expected.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.belief.cov[0], expected.cov, rtol=1e-12, atol=1e-15)
    taken = np.isfinite(trace.readings).any(axis=-1)
    np.testing.assert_array_equal(np.isfinite(found.innovations.nis[0]), taken)


def test_the_best_filter_has_white_innovations_of_the_covariance_that_it_states():
    """Whole runs are independent: 100 runs of an oscillator, which is linear."""
    setup = small(steps=40)
    histories = simulate(setup, range(100), keep=["readings"])
    assert histories.readings is not None
    found = innovations_of_all(setup, range(100), histories.readings, None)
    assert found is not None
    innovations = found.innovations
    freedoms = innovations.entries.sum()
    total = np.nansum(innovations.nis)
    assert abs(total - freedoms) < 4 * np.sqrt(2 * freedoms)
    normalised = innovations.value[..., 0] / np.sqrt(innovations.cov[..., 0, 0])
    series = normalised[:, :, :3, 0]
    products = series[:, 1:] * series[:, :-1]
    assert abs(products.mean()) < 4 / np.sqrt(products.size)


def test_a_node_that_returns_has_no_innovation_in_its_first_step():
    setup = small(steps=20, changes=("5 kill 1", "9 restart 1"))
    trace = read_trace(setup, in_memory(setup))
    found = of_trace(setup, trace)
    assert np.isnan(found.nis[5:10, 1]).all()
    assert np.isfinite(found.nis[[4, 10], 1]).all()
