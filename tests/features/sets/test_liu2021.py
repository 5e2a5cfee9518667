"""Receivers of sets behind a measurement bus: the report's sets, in every driver and under loss."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from concord.features.measurement_bus.measured import bus_of, receiver_of
from concord.features.measurement_bus.measurement_bus import losing_bids_of
from concord.features.measurement_bus.measurement_runs import estimate, slots_of
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.delivered import delivered
from concord.features.sets.filters.ellipsoid import Ellipsoid, half_widths
from concord.features.sets.filters.histories import sets_over
from concord.features.sets.liu2021 import plant_on_bus
from concord.features.sets.set_receivers import HeldValues
from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.papers.liu2021.runs import BUS, PLANT
from concord.results.records.trace import Trace, read_trace
from concord.runtime.batched.build import without_array_form
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.agree import near_differences
from tests.experiments.support import scenario, summary_of
from tests.features.sets.bounded_systems import on_the_sphere
from tests.test_agreement import assert_agreement

pytestmark = pytest.mark.slow

ELLIPSOIDS = ["tight", "fast-rate", "paper", "fast"]
SETS: list[dict[str, Any]] = [{"method": one} for one in ELLIPSOIDS]
SETS += [{"filter": "zonotope"}]
GAUSSIANS: list[dict[str, Any]] = [{"filter": one} for one in ("recommended", "kf", "ukf", "ekf")]


def star(**changes: Any) -> Setup:
    return prepare(scenario("liu2021", **{"steps": 21, **changes}))


def run(setup: Setup) -> Trace:
    return read_trace(setup, in_memory(setup))


def outside(trace: Trace) -> int:
    """Sets of the receiver that do not hold the truth."""
    radii = nees(trace.mean[:, 0] - trace.truth, trace.cov[:, 0])
    return int((~(radii <= 1.0)).sum())


# --- the sets ------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["paper", "fast", "tight", "fast-rate"])
def test_the_receiver_has_the_sets_of_a_history(method: str):
    """Same bus, same plant; `sets_over` works on cycles of a history, the receiver slot by slot."""
    rng = np.random.default_rng(3)
    _, outputs = liu2021.SYSTEM.simulate(on_the_sphere(rng, 3, 4), on_the_sphere(rng, 3, 15, 1))
    history = sets_over(PLANT, delivered(BUS, 2, outputs), np.zeros(4), np.eye(4), method)
    length = 1 if method == "fast-rate" else 3
    last = slice((length - 1) * 4, length * 4)
    sets = dict(enumerate(cast(list[Ellipsoid], history.sets), start=1))
    setup = star(method=method)
    on_bus, prior = plant_on_bus("matched"), Gaussian(np.zeros(4), np.eye(4))
    receiver = receiver_of(on_bus, setup.scenario, prior, losing_bids_of(build_bus(setup)))
    bus = bus_of(on_bus, setup.scenario)
    slots = slots_of(bus, np.moveaxis(outputs, 1, 0), np.zeros((3, 4)), first=0)
    beliefs = estimate(receiver, Received(slots.received, slots.fresh), first_slot=0)
    for step in range(3, 15, 3):
        known = sets[step // length]
        expected, width = known.centre[:, last], half_widths(known)[:, last]
        if method == "fast-rate":
            # The receiver's set of a step is cut by its readings too.
            assert (np.sqrt(np.diagonal(beliefs.cov[step], 0, -2, -1)) <= width * (1 + 1e-6)).all()
            continue
        np.testing.assert_allclose(beliefs.mean[step], expected, atol=2e-6)
        found = np.sqrt(np.diagonal(beliefs.cov[step], axis1=-2, axis2=-1))
        np.testing.assert_allclose(found, width, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("changes", SETS, ids=str)
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_every_set_holds_the_truth_also_where_frames_are_lost(changes: dict, loss: float):
    for number in range(4):
        setup = star(steps=39, run=number, loss=loss, **changes)
        trace = run(setup)
        assert outside(trace) == 0
        assert np.isfinite(trace.cov[:, 0]).all()
        missed = trace.counters[0].get("missed", 0)
        assert (missed > 0) == (loss > 0)


def test_a_lost_frame_of_the_contended_slot_ends_the_knowledge_of_what_contenders_hold():
    """Without that, the strip of a loser whose frame was lost before cuts off the truth."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(HeldValues, "after", _trusting)
        for number in range(12):
            trace = run(star(steps=30, run=number, loss=0.4, method="fast-rate"))
            if outside(trace) > 0 or "contradicting-reading" in trace.counters[0]:
                return
    pytest.fail("no set lost the truth")


def _trusting(held: HeldValues, received: Received, contenders: np.ndarray) -> HeldValues:
    return HeldValues(np.where(received.fresh, received.values, held.values), held.known)


def test_the_accuracy_of_a_set_is_an_option_and_its_gap_is_in_the_results():
    def gaps(method: str, accuracy: float) -> np.ndarray:
        found = run(star(steps=9, filter="ellipsoid", method=method, accuracy=accuracy)).duality_gap
        assert found is not None and np.isnan(found[:, 1:]).all()
        return found[:, 0]

    for method, every in (("tight", 3), ("paper", 3), ("fast-rate", 1)):
        rough, fine = gaps(method, 0.1), gaps(method, 1e-4)
        assert np.array_equal(~np.isnan(rough), np.arange(9) % every == every - 1)
        assert np.nanmax(fine) <= 1.5e-4 and np.nanmin(rough) > np.nanmax(fine), method
        assert np.nanmax(rough) <= 0.15
    assert run(star(steps=9, method="fast")).duality_gap is None


def test_the_gap_of_a_narrow_set_tells_how_near_the_least_it_is():
    """The last of these sets is 1e-3 wide; rounding at the end of the path left a gap of 1."""
    gap = run(star(steps=39, method="tight")).duality_gap
    assert gap is not None and np.nanmax(gap) <= 1e-2


def test_losers_make_the_sets_smaller():
    told, untold = run(star(method="fast-rate")), run(star(method="fast-rate", losers=False))
    sizes = [np.trace(one.cov[1:, 0], axis1=-2, axis2=-1).mean() for one in (told, untold)]
    assert sizes[0] < 0.99 * sizes[1]


def test_a_receiver_that_returns_begins_with_its_prior_and_holds_the_truth():
    for changes in SETS:
        setup = star(changes=("5 kill 0", "9 restart 0"), steps=15, **changes)
        trace = run(setup)
        there = np.isfinite(trace.mean[:, 0]).all(-1)
        assert there.tolist() == [True] * 5 + [False] * 4 + [True] * 6
        radii = nees(trace.mean[there, 0] - trace.truth[there], trace.cov[there, 0])
        assert (radii <= 1.0).all()


def test_the_summary_counts_the_sets_of_the_receiver_alone():
    setup = star()
    figures = summary_of(setup, run(setup))
    assert figures.verdict.said == "sets: 0 of 21 do not hold the truth"
    known = [np.isnan(node["set_half_width"].value) for node in figures.nodes]
    assert known == [False] + [True] * 4
    assert figures.value("set_half_width") < 3
    # All four outputs at once, with the one noise that disturbs them, tell the state.
    assert figures.value("rmse_centralised") < 1e-9


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"number": "float32"}, "--number float32: must be float64: a set takes"),
        ({"hold": "zero-input"}, "--hold zero-input: must be zero-order"),
        ({"schedule": "dynamic"}, "--method tight works by communication cycles"),
        ({"changes": ("3 kill 4",)}, "--changes 3 kill: .*add --no-losers"),
        ({"nodes": 6}, "--nodes 6: must be 5"),
        (
            {"method": "fast", "accuracy": 0.1},
            "--accuracy 0.1: must be left out with --method fast",
        ),
        ({"filter": "imm"}, "--filter imm: its models are a straight course and a turn"),
        ({"filter": "aukf"}, "--filter aukf: it learns the noise of a node's own sensors"),
    ],
)
def test_what_a_receiver_of_sets_cannot_have(changes: dict, says: str):
    with pytest.raises(ValueError, match=says):
        star(**changes)


def test_sets_belong_to_a_measurement_bus():
    with pytest.raises(ValueError, match="--filter zonotope: it is for the receiver of a measure"):
        prepare(scenario("oscillator", filter="zonotope"))


# --- drivers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [*SETS, *GAUSSIANS], ids=str)
def test_the_batched_driver_agrees_with_messages(changes: dict):
    setup = star(loss=0.2, changes=("12 kill 1", "15 cut 0 2"), steps=18, **changes)
    assert without_array_form(setup.scenario) is None
    assert near_differences(setup, run(setup)) == []


@pytest.mark.parametrize("bus", ["can-fd", "plca", "ideal"])
def test_other_buses_carry_measurements_too(bus: str):
    kept = {"schedule": "full"} if bus == "ideal" else {}
    trace = run(star(bus=bus, method="fast-rate", **kept))
    assert outside(trace) == 0


def test_a_restart_goes_message_by_message():
    setup = star(changes=("5 kill 1", "9 restart 1"))
    assert without_array_form(setup.scenario) == "restarts on a measurement bus (--changes)"


@pytest.mark.zenoh
@pytest.mark.parametrize("changes", [SETS[0], SETS[4], GAUSSIANS[1]], ids=str)
def test_processes_give_the_same_bits(changes: dict, tmp_path: Path):
    assert_agreement(star(loss=0.2, steps=9, **changes), tmp_path)
