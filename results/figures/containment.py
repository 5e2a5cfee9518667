"""Whether sets hold the truth, and how large they are: in place of ANEES where sets are certain."""

import msgspec
import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees


class Containment(msgspec.Struct, frozen=True):
    """Ellipsoids e' P^-1 e <= 1 against the truth, over all steps in which both are there.

    Attributes:
        violations: how many do not hold the truth. sets: of how many.
        largest: the largest e' P^-1 e; at most 1 where there is no violation.
        half_width: mean over steps of the half-widths' root sum of squares, sqrt(tr P).
    """

    violations: int
    largest: float
    half_width: float
    sets: int


def containment(bounds: Gaussian, truth: np.ndarray, kept: np.ndarray | bool = True) -> Containment:
    """Of bounds mean (steps, ..., n), cov (steps, ..., n, n) and truth (steps, n).

    `kept` (steps, ...) is False where there is no set: a node that is out keeps none.
    """
    spread = truth.reshape(len(truth), *(1,) * (bounds.mean.ndim - 2), -1)
    values = nees(bounds.mean - spread, bounds.cov)
    known = np.broadcast_to(~np.isnan(spread).any(-1) & kept, values.shape)
    kept = np.broadcast_to(kept, values.shape)
    # Not "above 1": what cannot be computed is no proof.
    outside = known & ~(values <= 1.0)
    squares = np.trace(bounds.cov, axis1=-2, axis2=-1)
    sizes = np.sqrt(np.where(squares >= 0, squares, np.nan))
    return Containment(
        violations=int(outside.sum()),
        largest=float(values[known].max()) if known.any() else float("nan"),
        half_width=float(sizes[kept].mean()) if kept.any() else float("nan"),
        sets=int(known.sum()),
    )
