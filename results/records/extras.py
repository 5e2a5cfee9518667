"""Hook of results for scenarios whose nodes tell more than a belief, for example tracks."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from concord.entries import member
from concord.nodes.messages import ReportedTracks
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    import xarray

Told = Mapping[tuple[int, int], ReportedTracks | None]
"""The tracks that nodes tell, by (step, node)."""


class Past(NamedTuple):
    """Mean and standard deviation of smoothed states, (..., steps, L, N, n).

    Entry (k, l) is the state of step k - l given what a node knew after step k; NaN for k < l.
    """

    mean: np.ndarray
    std: np.ndarray


class RunExtra(Protocol):
    """Messages of one run beside beliefs, as the scenario reads them."""

    def distances(self) -> np.ndarray:
        """Errors (steps, N) in place of those of the beliefs, NaN while a node was out."""
        ...

    def digest_numbers(self) -> np.ndarray:
        """Integers (steps, N, k), which are equal where nodes told the same."""
        ...


class ExtraFigures(Protocol):
    """Figures of one `RunExtra`, a struct for machines."""

    def lines(self) -> list[str]:
        """Return the figures in words."""
        ...


class RunExtras(NamedTuple):
    """Functions of a scenario on the values X, a kind of `RunExtra`, of its runs.

    `readings` are those of the run (steps, N, r, d), or of R runs (R, steps, N, r, d).

    Attributes:
        read: (setup, states of the plant (steps, ...), what nodes told) -> X.
        distances_of_centre: (setup, X, readings) -> errors (steps,) of one estimator that hears
            everything.
        distances_alone: (setup, X, readings) -> errors (steps, N) of nodes without neighbours.
        figures: (setup, X, readings) -> figures of the run.
        figures_of_runs: (setup, X of R runs, readings) -> values (R,) by the names in the table
            FIGURES of the feature (`concord.entries`).
        variables: (setup, numbers of runs, X of each, readings or None) -> variables of run.nc.
        read_runs: (data set of R runs, setup, which nodes took part (R, steps, N)) -> X of each.
    """

    read: Callable[[Setup, np.ndarray, Told], RunExtra]
    distances_of_centre: Callable[[Setup, Any, np.ndarray], np.ndarray]
    distances_alone: Callable[[Setup, Any, np.ndarray], np.ndarray]
    figures: Callable[[Setup, Any, np.ndarray], ExtraFigures]
    figures_of_runs: Callable[[Setup, Sequence[Any], np.ndarray], dict[str, np.ndarray]]
    variables: Callable[
        [Setup, Sequence[int], Sequence[Any], np.ndarray | None], dict[str, tuple[Any, ...]]
    ]
    read_runs: Callable[["xarray.Dataset", Setup, np.ndarray], Sequence[RunExtra]]


def run_extras(scenario: Scenario) -> RunExtras | None:
    """Return the functions of a scenario; None where its nodes tell beliefs alone."""
    target = definition_of(scenario).results
    return member(target) if target else None
