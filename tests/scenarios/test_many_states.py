"""Plants of many states: shares of several frames, and what a bus holds of them."""

import re

import numpy as np
import pytest

from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.preparation import prepare, share_bytes
from concord.scenarios.rule_table.labelled import share_limits
from concord.scenarios.scenario import Scenario
from concord.studies.monte_carlo.simulate import simulate
from tests.features.rows import rows_of_features

STATES = (4, 10, 30, 60)
TOO_SHORT = rows_of_features("BUSES_OF_SHORT_SHARES")


def many(states: int, channels: int = 2, **options: object) -> Scenario:
    """A plant that turns in so many states, seen by six nodes of a ring; one is blind."""
    rng = np.random.default_rng(states)
    turn = 0.98 * np.linalg.qr(rng.normal(size=(states, states)))[0]
    plant = OwnPlant(
        f=lambda x: x @ turn.T, Q=[0.01] * states, mean=[0.0] * states, cov=[1.0] * states
    )

    def sensor() -> OwnSensor:
        rows = rng.normal(size=(channels, states))
        return OwnSensor(h=lambda x: x @ rows.T, R=[0.1] * channels)

    sensors = [*(sensor() for _ in range(5)), None]
    return own_scenario(plant, sensors, nodes=6, steps=24).with_(rule="labelled", **options)


def messages(asked: Scenario) -> Trace:
    setup = prepare(asked)
    return read_trace(setup, in_memory(setup))


@pytest.mark.parametrize("bus", ["ideal", *rows_of_features("BUSES_OF_LONG_SHARES")])
@pytest.mark.parametrize("states", STATES)
def test_labelled_has_the_estimates_of_a_filter_that_hears_everything(states: int, bus: str):
    """Each node has all records of all nodes in a step, so that all estimates are one."""
    histories = simulate(prepare(many(states, bus=bus)), [0, 1], keep=["cov"])
    assert histories.cov is not None
    spread = np.ptp(histories.mean[:, -1], axis=1)
    assert (spread < 1e-9).all()
    nees = histories.nees[:, 10:].mean() / states
    assert 0.5 < nees < 1.6


@pytest.mark.parametrize("states", [10, 30])
@pytest.mark.parametrize(
    "options",
    [
        {"occupancy": 0.2},
        {"occupancy": 0.2, "schedule": "round-robin"},
        {"occupancy": 0.2, "loss": 0.1},
    ],
)
def test_checkpoints_come_in_several_frames(states: int, options: dict):
    """Records are older than the window when they come, so nodes need the bases of others."""
    asked = many(states, rounds=1, window_steps=2, **options)
    trace, limits = messages(asked), share_limits(asked, states)
    assert sum(one.get("checkpoint-fused", 0) for one in trace.counters) > 0
    assert limits.longest == share_bytes(prepare(asked)) > 254
    # Static slots have one length. Elsewhere the shares with a checkpoint alone are longer.
    assert (limits.usual < limits.longest) == ("schedule" not in options)
    assert trace.payload_bytes.max() > 254
    error = trace.mean[-1] - trace.truth[-1]
    nees = [e @ np.linalg.solve(p, e) / states for e, p in zip(error, trace.cov[-1], strict=True)]
    assert max(nees) < 3
    if "loss" not in options:
        histories = simulate(prepare(asked), [0])
        np.testing.assert_array_equal(histories.payload_bytes[0], trace.payload_bytes)
        np.testing.assert_allclose(histories.mean[0], trace.mean, rtol=1e-6, atol=1e-6)


def test_records_of_many_channels_make_shares_long_enough():
    asked = many(60, channels=60, bus="ideal")
    histories = simulate(prepare(asked), [0])
    assert np.ptp(histories.mean[0, -1], axis=0).max() < 1e-9


@pytest.mark.parametrize(
    ("options", "numbers"),
    [
        ({"rule": "labelled"}, r"6 shares of 7562 bytes \(they take 50.6 ms\)"),
        ({"rule": "ci"}, r"6 shares of 15120 bytes \(they take 101.2 ms\)"),
        *(({"rule": "ci", "bus": bus}, said) for bus, said in TOO_SHORT.items()),
        ({"rule": "hcmci", "cluster": "audi", "number": "float32"}, "need .* frames of 30 bytes"),
        ({"rule": "labelled", "cluster": "audi"}, "7562 bytes need 291 frames of 30 bytes"),
    ],
)
def test_each_option_that_is_named_fits(options: dict, numbers: str):
    with pytest.raises(ValueError, match=numbers) as refused:
        prepare(many(60).with_(**options))
    said = str(refused.value)
    assert "a share of rule" in said
    named = re.sub(r" \([\d,]+ bytes\)", "", said.split("one of these fits: ")[1]).split(", ")
    assert "--bus ideal" in named
    for one in named:
        words = one.replace("--", "").split()
        fitting = dict(zip(words[::2], words[1::2], strict=True))
        changes = {name: float(v) if name == "occupancy" else v for name, v in fitting.items()}
        prepare(many(60).with_(**options).with_(**changes))
