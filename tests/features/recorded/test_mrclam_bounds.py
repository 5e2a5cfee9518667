"""Four real robots track the fifth: the bounds that a correct network meets on UTIAS MRCLAM set 6.

The bounds come from the project's study of the data, in which every robot was the target once. Some
combinations run always, the others as slow tests.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from concord.results.figures.summary import Summary
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario, summary_of

pytestmark = pytest.mark.slow

TARGETS = (1, 2, 3, 4, 5)


class Way(NamedTuple):
    """A way to exchange, and the bound on near error of its worst node over the centralised."""

    graph: str
    rounds: int
    held: bool
    near: float


WAYS = {
    "ci complete": Way("complete", 1, False, 1.7),
    "ci ring, three rounds": Way("ring", 3, False, 1.7),
    "ci path, three rounds": Way("path", 3, False, 1.75),
    "ci ring": Way("ring", 1, False, 2.0),
    "ci path": Way("path", 1, False, 2.3),
    "held complete": Way("complete", 1, True, 2.3),
    "held ring": Way("ring", 1, True, 2.4),
    "held path": Way("path", 1, True, 2.7),
}
# Ways on which every robot is the target once; on the others the fifth is.
OFTEN = ("ci complete", "held path")
ALL_ERROR, ALL_GAIN, NEAR_GAIN = 1.18, 1.15, {False: 2.8, True: 2.3}
# RMSE of one filter that hears everything, in m, for targets 1 to 5: the study's figures.
CENTRALISED_ALL = (0.600, 0.470, 1.279, 0.491, 0.631)
CENTRALISED_NEAR = (0.124, 0.195, 0.153, 0.135, 0.150)
BEST_NODE_ALL = (1.16, 1.13, 1.65, 1.16, 0.98)


@cache
def outcome(folder: str, target: int, way: Way, steps: int = 3860) -> tuple[Summary, Trace]:
    """Summary and arrays of a recording, of all of it for the bounds."""
    changes = {"schedule": "round-robin", "occupancy": 0.25} if way.held else {}
    asked = scenario(
        "mrclam",
        data=folder,
        target=target,
        steps=steps,
        graph=way.graph,
        rounds=way.rounds,
        **changes,
    )
    setup = prepare(asked)
    trace = read_trace(setup, in_memory(setup))
    return summary_of(setup, trace), trace


def check_bounds(figures: Summary, way: Way) -> None:
    """Bounds 1 and 2: the worst node against the centralised filter and the best lonely one."""
    every, near, alone = (
        [node[name].value for node in figures.nodes] for name in ("rmse", "rmse_near", "rmse_alone")
    )
    assert max(every) <= ALL_ERROR * figures.value("rmse_centralised")
    assert max(near) <= way.near * figures.value("rmse_near_centralised")
    assert min(alone) >= ALL_GAIN * max(every)


def check_frame(figures: Summary, target: int) -> None:
    """The filters that frame the network are the study's, to its last printed digit."""
    place = target - 1
    local = min(node["rmse_alone"].value for node in figures.nodes)
    assert figures.value("rmse_centralised") == pytest.approx(CENTRALISED_ALL[place], abs=0.0006)
    assert figures.value("rmse_near_centralised") == pytest.approx(
        CENTRALISED_NEAR[place], abs=0.0006
    )
    assert local == pytest.approx(BEST_NODE_ALL[place], abs=0.006)


def test_bounds(mrclam_folder):
    """The hardest way to exchange, on one target: the quick look at all that follows."""
    figures, trace = outcome(str(mrclam_folder), 5, WAYS["held path"])
    assert trace.steps == 3860
    check_bounds(figures, WAYS["held path"])
    check_frame(figures, 5)


def test_nodes_of_a_complete_graph_are_identical(mrclam_folder):
    _, trace = outcome(str(mrclam_folder), 4, WAYS["ci complete"], steps=500)
    for values in (trace.mean, trace.cov):
        np.testing.assert_allclose(values, values[:, :1].repeat(4, axis=1), rtol=1e-12, atol=1e-12)


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "target"),
    [(name, target) for name in OFTEN for target in TARGETS]
    + [(name, TARGETS[-1]) for name in WAYS if name not in OFTEN],
)
def test_bounds_of_all(mrclam_folder, name: str, target: int):
    figures, _ = outcome(str(mrclam_folder), target, WAYS[name])
    check_bounds(figures, WAYS[name])
    check_frame(figures, target)


@pytest.mark.study
@pytest.mark.parametrize("name", OFTEN)
def test_consistency_over_all_targets(mrclam_folder, name: str):
    """Bound 3: ANEES of the network and of the centralised filter, mean over targets."""
    found = [outcome(str(mrclam_folder), target, WAYS[name])[0] for target in TARGETS]
    assert 0.55 <= np.mean([figures.value("anees") for figures in found]) <= 1.2
    assert 0.8 <= np.mean([figures.value("anees_centralised") for figures in found]) <= 1.5
