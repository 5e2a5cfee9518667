"""Iterated filters: a measurement is linearised about the posterior that it leads to.

The first pass linearises about the prediction. Each later pass linearises about the result of the
pass before, and updates the prediction anew with that affine model; the reading is counted once.
Over a sigma-point filter this is iterated posterior linearisation, over the extended filter the
iterated extended Kalman filter, which is Gauss-Newton for the most likely state.

Sources: Garcia-Fernandez, Svensson, Morelande and Sarkka (2015), Posterior linearization filter:
principles and implementation using sigma points, algorithm 1; Bell and Cathey (1993), The iterated
Kalman filter update as a Gauss-Newton method.
"""

from dataclasses import dataclass

import numpy as np

from concord.filters.filter import Linearising
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import multiply, symmetrise
from concord.filters.moments import Model, Residual
from concord.filters.update import Update, condition


@dataclass(frozen=True)
class IteratedFilter:
    """The filter `inner` with at most `iterations` passes of an update.

    A lane stops when a pass moves no state by more than `tolerance` of its standard deviation, so
    that it has the same passes alone and beside others.
    """

    inner: Linearising
    iterations: int = 10
    tolerance: float = 1e-3

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """Return the prediction of `inner`; a prediction has nothing to iterate on."""
        return self.inner.predict(belief, transition, noise_cov)

    def update(
        self,
        belief: Gaussian,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> Update:
        """The belief given a measurement; innovation and gate are those of the first pass."""
        measurement = np.asarray(measurement, dtype=float)
        first = self.inner.update(
            belief, measurement, measure, noise_cov, residual=residual, gate=gate
        )
        after = first.belief
        open_lanes = np.logical_not(np.isnan(measurement).all(axis=-1))
        if gate is not None:
            open_lanes = open_lanes & (first.normalised_innovation_squared <= gate)
        for _ in range(self.iterations - 1):
            if not open_lanes.any():
                break
            affine = self.inner.linearise(after, measure, measurement.shape[-1], residual)
            cross_cov = belief.cov @ affine.slope.mT
            found = condition(
                belief,
                measurement,
                affine.predicted + multiply(affine.slope, belief.mean - after.mean),
                symmetrise(affine.slope @ cross_cov) + affine.error_cov + noise_cov,
                cross_cov,
                residual,
            ).belief
            deviation = np.sqrt(np.abs(np.diagonal(found.cov, axis1=-2, axis2=-1)))
            moved = np.abs(found.mean - after.mean) > self.tolerance * deviation
            sound = np.isfinite(found.mean).all(axis=-1) & np.isfinite(found.cov).all(axis=(-1, -2))
            taken = open_lanes & sound
            after = Gaussian(
                np.where(taken[..., None], found.mean, after.mean),
                np.where(taken[..., None, None], found.cov, after.cov),
            )
            open_lanes = taken & moved.any(axis=-1)
        return first._replace(belief=after)
