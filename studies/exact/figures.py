"""Exact errors under the names of the table of figures, so that sweeps, designs and comparisons
take them in place of runs."""

from collections.abc import Sequence
from functools import lru_cache

import msgspec
import numpy as np

from concord.results.figures.figure_table import FIGURES, SWEPT, computed
from concord.results.figures.run_frame import frame_of
from concord.results.figures.run_view import RunView
from concord.scenarios.links import link_state
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.studies.exact.results import Exact, exact_of
from concord.studies.monte_carlo.simulate import simulate

# Figures that no error enters: one run, or the run with these losses, has them exactly.
_OF_TRAFFIC = (
    "failed", "published", "bytes_per_step", "energy_per_step", "bus_load", "bus_load_all",
    "bus_time_us", "delay_us", "share_age", "share_age_max", "share_age_all", "never_heard",
    "bound", "bound_state",
)  # fmt: skip


def exact_figures(scenario: bytes, first: int, last: int) -> dict[str, np.ndarray]:
    """Return the figures of runs `first` to before `last` of a scenario (JSON), as expectations
    over the noise of plant and sensors; a run is a pattern of losses.

    Figures that need more than second moments, such as coverage, are NaN.

    Raises:
        NotExact: the scenario has no exact covariances.
    """
    setup = prepare(msgspec.json.decode(scenario, type=Scenario))
    if not link_state(setup).perfect:
        return _figures(setup, range(first, last))
    alone = _without_losses(scenario)
    return {
        name: np.repeat(values, last - first, axis=0) if "run" in FIGURES[name].dimensions
        else values
        for name, values in alone.items()
    }  # fmt: skip


@lru_cache(maxsize=512)
def _without_losses(scenario: bytes) -> dict[str, np.ndarray]:
    return _figures(prepare(msgspec.json.decode(scenario, type=Scenario)), range(1))


def _figures(setup: Setup, runs: Sequence[int]) -> dict[str, np.ndarray]:
    exact = exact_of(setup, runs)
    simulated = simulate(setup, runs)
    view = RunView(simulated, frame_of(simulated))
    traffic = computed(view, _OF_TRAFFIC)
    blind = np.asarray(np.isnan(view.readings[:, 0]).all(axis=(-1, -2)))
    errors = {**_of_errors(exact, blind), **traffic}
    sizes = {
        "run": len(runs), "step": setup.scenario.steps, "state": len(setup.prior_mean),
        "node": setup.scenario.nodes,
    }  # fmt: skip
    return {
        name: errors[name] if name in errors
        else np.full([sizes[one] for one in FIGURES[name].dimensions], np.nan)
        for name in SWEPT
    }  # fmt: skip


def _of_errors(exact: Exact, blind: np.ndarray) -> dict[str, np.ndarray]:
    scored, patterns = exact.scored, len(exact.squares)
    squares, nees = exact.squares[:, scored], exact.nees[:, scored]
    states = np.diagonal(exact.errors[:, scored], axis1=-2, axis2=-1)

    def alike(values: np.ndarray | float) -> np.ndarray:
        return np.tile(values, (patterns, *(1,) * np.ndim(values)))

    nodes = np.sqrt(squares.mean(axis=1))
    unseen = np.where(blind[:, None], squares, 0.0).sum(axis=(1, 2))
    count = blind.sum(axis=1) * squares.shape[1]
    return {
        "rmse": np.sqrt(squares.mean(axis=(1, 2))),
        "rmse_centralised": alike(exact.rmse_centralised).reshape(patterns),
        "rmse_blind": np.sqrt(np.divide(unseen, count, np.full(patterns, np.nan), where=count > 0)),
        "rmse_worst_node": nodes.max(axis=1),
        "disagreement": np.sqrt(exact.spread[:, scored].mean(axis=(1, 2))),
        "anees": nees.mean(axis=(1, 2)),
        "anees_centralised": alike(exact.nees_centralised[scored].mean()).reshape(patterns),
        "rmse_state": np.sqrt(states.mean(axis=(1, 2))),
        "rmse_node": nodes,
        "error": np.sqrt(exact.squares.mean(axis=2)),
        "error_centralised": alike(np.sqrt(exact.squares_centralised)),
        "spread": np.sqrt(exact.spread.mean(axis=2)),
        "nees": exact.nees.mean(axis=2),
    }
