"""A new arbiter is one function and one line in one table: it runs in every driver."""

import numpy as np
import pytest

from concord.bus.arbitration import ARBITERS, Arbiter, ArbiterState, Numbers
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.bus_table.bus_plan import arbiter_names
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate

NAME = "longest-wait"


def longest_wait(state: ArbiterState, bids: Numbers, frame_ids: Numbers) -> Numbers:
    """Serve the node first that has asked in vain for longest."""
    return -state.waits


def setup_of(arbiter: str, cluster: str) -> Setup:
    options = scenario_of(
        scenario="oscillator", graph="ring", nodes=8, steps=6, schedule="dynamic", occupancy=0.4,
        arbiter=arbiter, cluster=cluster, number="float32",
    )  # fmt: skip
    return prepare(options)


def trace_of(setup: Setup) -> Trace:
    return read_trace(setup, in_memory(setup))


@pytest.mark.parametrize("cluster", ["fitted", "flexray-adapter"])
def test_a_new_arbiter_runs_in_every_driver(monkeypatch: pytest.MonkeyPatch, cluster: str):
    """All winners fit the fitted cluster; on the other one, requests compete for minislots too."""
    monkeypatch.setitem(ARBITERS, NAME, Arbiter(longest_wait))
    assert NAME in arbiter_names()
    setup = setup_of(NAME, cluster)
    trace = trace_of(setup)
    histories = simulate(setup, range(2))
    np.testing.assert_allclose(histories.mean[0], trace.mean, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(histories.payload_bytes[0], trace.payload_bytes)
    # All contenders are served in turn, so none waits for longer than the others take.
    assert (trace.published.reshape(-1, 8).sum(axis=0) > 0).all()
    assert not np.array_equal(trace.published, trace_of(setup_of("minislot", cluster)).published)
