"""Normalised innovations squared of the nodes, step by step, from what they told."""

from typing import NamedTuple

import numpy as np

from concord.dashboard.frames.told import StepContent, delivered
from concord.filters.gaussian import Gaussian
from concord.scenarios.innovations import InnovationFilters, Learnt, innovation_filters
from concord.scenarios.setup import Setup


class StepNis(NamedTuple):
    """Innovations of a step: their normalised squares (N,), added up over a node's readings, and
    degrees of freedom (N,). Both are 0 where no reading was taken or the step before is unknown."""

    squares: np.ndarray
    freedoms: np.ndarray

    def of(self, node: int | None = None) -> float:
        """NIS per degree of freedom of a node, of all nodes for None; NaN without a reading."""
        squares, freedoms = (
            float(values.sum() if node is None else values[node]) for values in self
        )
        return squares / freedoms if freedoms else float("nan")


class InnovationsTold:
    """Computes the innovations of each step from the estimates of the step before."""

    def __init__(self, setup: Setup) -> None:
        nodes = setup.scenario.nodes
        self._setup, self._last = setup, -1
        mean, cov = np.array(setup.prior_mean), np.array(setup.prior_cov)
        self._before = Gaussian(
            np.repeat(mean[None], nodes, axis=0), np.repeat(cov[None], nodes, axis=0)
        )
        self._filters: InnovationFilters | None = None
        self._learnt: Learnt = ()

    def follow(self, setup: Setup) -> None:
        """Take the sensors of this setup from now on."""
        self._setup, self._filters = setup, None

    def add(self, number: int, told: StepContent, after: Gaussian, alive: np.ndarray) -> StepNis:
        """The innovations of a step, after which the living nodes (N,) have beliefs (N, n)."""
        before, follows = self._before, number == self._last + 1
        known = Gaussian(
            np.where(alive[:, None], after.mean, np.nan),
            np.where(alive[:, None, None], after.cov, np.nan),
        )
        self._before, self._last = known, number
        nodes = len(alive)
        nothing = StepNis(np.zeros(nodes), np.zeros(nodes, dtype=int))
        readings, control = delivered(told, nodes)
        if readings is None or not follows:
            return nothing
        if self._filters is None:
            self._filters = innovation_filters(self._setup, readings.shape[-2:])
        if self._filters is None:
            return nothing
        found, self._learnt = self._filters.of_nodes(
            Gaussian(before.mean[None], before.cov[None]),
            readings[None],
            None if control is None else control[None],
            number,
            self._learnt,
        )
        return StepNis(np.nansum(found.nis[0], axis=-1), found.entries[0].sum(axis=-1))
