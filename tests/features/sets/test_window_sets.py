"""Labelled readings under sets: certain whatever is lost, and as narrow as rounding allows."""

import numpy as np
import pytest

from concord.features.sets.window_sets import WindowSets
from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.scenarios.build import build_node
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.support import scenario
from tests.test_batched_agreement import check_agreement

DIES = "12 kill 3"


def asked(**changes) -> Scenario:
    settings = {"rule": "labelled-ellipsoid", "occupancy": 0.3, "schedule": "dynamic"}
    return scenario("liu2021-network", **{"steps": 30, **settings, **changes})


def radii_and_widths(asked: Scenario, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """e' P^-1 e and sqrt tr P (R, S, N) of several runs."""
    histories = simulate(prepare(asked), list(range(runs)), keep=frozenset({"cov"}))
    assert histories.cov is not None
    radii = nees(histories.mean - histories.truth[:, :, None], histories.cov)
    return radii, np.sqrt(np.trace(histories.cov, axis1=-2, axis2=-1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"loss": 0.1, "changes": (DIES,)},
        # Records come late, and checkpoints go where the window has forgotten them.
        {"loss": 0.5, "window_steps": 4},
        {"loss": 0.3, "window_steps": 1},
        {"control": "open", "loss": 0.1},
    ],
    ids=["a node dies", "checkpoints", "one step", "uncontrolled"],
)
def test_no_set_misses_the_truth(changes: dict):
    radii, _ = radii_and_widths(asked(**changes), runs=6)
    if "changes" in changes:
        assert np.isnan(radii[:, 12:, 3]).all()
        radii[:, 12:, 3] = 0.0
    assert (radii <= 1).all()


def test_readings_determine_the_state_where_shared_sets_leave_it_wide():
    """Four outputs with one noise are more equations than unknowns after two steps."""
    _, widths = radii_and_widths(asked(loss=0.1), runs=4)
    _, shared = radii_and_widths(asked(loss=0.1, rule="ellipsoid"), runs=4)
    assert np.median(widths[:, 5]) < 1e-9
    assert np.median(shared[:, 5]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"loss": 0.1, "changes": (DIES,), "steps": 20},
        {"loss": 0.5, "window_steps": 3, "nodes": 4, "steps": 16},
        {"occupancy": 1.0, "schedule": "full", "control": "open", "steps": 8},
    ],
)
def test_the_batched_driver_has_the_same_sets(changes: dict):
    check_agreement(asked(**changes))


def test_checkpoints_that_meet_hold_both_sets_and_others_fail():
    node = build_node(prepare(asked()), 0).estimator
    assert isinstance(node, LabelledFlooding)
    sets = node.filter
    assert isinstance(sets, WindowSets)
    rng = np.random.default_rng(3)
    own = Gaussian(np.zeros((1, 1, 4)), np.eye(4)[None, None])
    near = Gaussian(np.full((1, 1, 4), 0.4), 0.5 * np.eye(4)[None, None])
    fused = sets.fused(own, near)
    points = rng.uniform(-1, 1, (4000, 4))
    in_both = ((points**2).sum(-1) <= 1) & (((points - 0.4) ** 2).sum(-1) <= 0.5)
    assert in_both.sum() > 100
    held = nees(points[in_both] - fused.mean[0, 0], np.broadcast_to(fused.cov[0, 0], (4, 4)))
    assert (held <= 1).all()
    far = near._replace(mean=near.mean + 5.0)
    assert np.isnan(sets.fused(own, far).mean).all()


@pytest.mark.parametrize("rule", ["labelled-ellipsoid", "labelled"])
def test_a_checkpoint_around_the_same_centre_is_news_if_it_is_smaller(rule: str):
    """Only the centre was compared: rounding decided whether narrow sets were fused."""
    node = build_node(prepare(asked(rule=rule)), 0).estimator
    assert isinstance(node, LabelledFlooding)
    content = node.start()
    mean, cov = (values[0, 0] for values in content.windows.base)
    for size, says in ((0.9, "fused"), (1.0, "known"), (1.1, "known")):
        after, result = content.kept.fused(node.filter, Gaussian(mean, size * cov))
        assert result == says
        width = np.sqrt(min(size, 1.0) * np.trace(cov))
        assert np.sqrt(np.trace(after.windows.base.cov[0, 0])) == pytest.approx(width, rel=1e-6)


def test_a_plant_without_bounds_is_refused():
    with pytest.raises(ValueError, match="rule labelled-ellipsoid on oscillator: its noise has no"):
        prepare(scenario("oscillator", rule="labelled-ellipsoid"))
