"""InnovationLikelihood of innovations, its slopes by lanes, and what it tells of the values.

The innovations v with covariance S are those of the filter that hears everything. With the negative
logarithm L = sum (log det S + v' S^-1 v) / 2 and derivatives v_i, S_i by value i, the information
is

    M_ij = sum tr(S^-1 S_i S^-1 S_j) / 2 + v_i' S^-1 v_j

and the covariance of the estimate M^-1 J M^-1, with the scatter J of the scores of blocks of steps.

Sources: Gupta and Mehra (1974), Computational aspects of maximum likelihood estimation and
reduction in sensitivity function calculations; White (1982), Maximum likelihood estimation of
misspecified models.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from concord.filters.linalg import cholesky, inverse_of_triangle, multiply
from concord.filters.update import Update
from concord.studies.identify.readings import HeardReadings, updates

DIFFERENCE = 1e-5
"""Of a value between two lanes, in the coordinates of the fit."""
BLOCKS = 40
"""Parts of a log whose scores count as independent."""
_KEPT = 256  # updates that are summed at a time
_TOLD_STEPS = 200  # between two calls of progress


class InnovationLikelihood(NamedTuple):
    """The negative logarithm of the likelihood, slopes (p,), information (p, p) and scatter (p, p)
    of the slopes; values (lanes,) of all lanes, infinite for one that fails."""

    value: float
    slopes: np.ndarray
    information: np.ndarray
    scatter: np.ndarray
    lanes: np.ndarray


def likelihood(
    log: HeardReadings,
    values: Mapping[str, Any],
    lanes: int,
    on_steps: Callable[[int], None],
    slopes: bool = True,
) -> InnovationLikelihood:
    """The likelihood of values by name, numbers or arrays (lanes,).

    With `slopes`, lane 1 + i has value i moved by `DIFFERENCE`. `on_steps` is told of each batch of
    steps that is done.
    """
    sums = _Sums(lanes, lanes - 1 if slopes else 0)
    kept: dict[int, list[tuple[int, Update]]] = {}
    for step, found in updates(log, values, lanes):
        block = step * BLOCKS // log.steps
        for one in found:
            some = kept.setdefault(one.innovation.shape[-1], [])
            some.append((block, one))
            if len(some) == _KEPT:
                sums.add(some)
                some.clear()
        if step % _TOLD_STEPS == _TOLD_STEPS - 1:
            on_steps(_TOLD_STEPS)
    for some in kept.values():
        if some:
            sums.add(some)
    on_steps(log.steps % _TOLD_STEPS)
    return sums.likelihood()


class _Sums:
    def __init__(self, lanes: int, count: int) -> None:
        self._count = count
        self._values = np.zeros(lanes)
        self._information = np.zeros((count, count))
        self._blocks = np.zeros((BLOCKS, count))

    def add(self, some: list[tuple[int, Update]]) -> None:
        """Add updates of the same number of entries, each with the block of its step."""
        v = np.stack([one.innovation for _, one in some])
        s = np.stack([one.innovation_cov for _, one in some])
        missing = np.isnan(v)
        either = missing[..., :, None] | missing[..., None, :]
        v, s = np.where(missing, 0.0, v), np.where(either, np.eye(v.shape[-1]), s)
        factor = cholesky(s)
        whitener = inverse_of_triangle(factor)
        white = multiply(whitener, v)
        halves = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        terms = 0.5 * np.vecdot(white, white) + halves
        self._values += terms.sum(axis=0)
        if not self._count:
            return
        scores = (terms[:, 1:] - terms[:, :1]) / DIFFERENCE
        np.add.at(self._blocks, [block for block, _ in some], scores)
        first = whitener[:, :1]
        bent = first @ ((s[:, 1:] - s[:, :1]) / DIFFERENCE) @ first.mT
        moved = multiply(first, (v[:, 1:] - v[:, :1]) / DIFFERENCE)
        parts = [np.sqrt(0.5) * bent.reshape(*bent.shape[:2], -1), moved]
        rows = np.concatenate(parts, axis=-1).swapaxes(0, 1).reshape(self._count, -1)
        self._information += rows @ rows.T

    def likelihood(self) -> InnovationLikelihood:
        """Return the sums."""
        lanes = np.where(np.isfinite(self._values), self._values, np.inf)
        scatter = self._blocks.T @ self._blocks
        slopes = self._blocks.sum(axis=0)
        return InnovationLikelihood(float(lanes[0]), slopes, self._information, scatter, lanes)
