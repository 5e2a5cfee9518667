"""Square-root unscented and cubature Kalman filters: both half steps by triangular factors."""

from dataclasses import dataclass

import numpy as np

from concord.filters import square_root
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, Residual, check_noise
from concord.filters.sigma_points import SigmaPointRule
from concord.filters.update import Update


@dataclass(frozen=True, eq=False)
class SquareRootFilter:
    """`square_root.predict` and `square_root.update` with one rule, as a value.

    The update loses no digits where a reading is far sharper than its prediction. A belief between
    two calls is a covariance, because nodes fuse and share covariances, so the form does not keep
    more digits than a covariance holds.

    Raises:
        ValueError: a weight of the rule for covariances is negative and has no root.
    """

    rule: SigmaPointRule

    def __post_init__(self) -> None:
        if (self.rule.cov_weights < 0).any():
            raise ValueError(
                f"the sigma points for {self.rule.unit_points.shape[1]} states have a negative "
                "weight, which has no square root: use cubature points (--filter srckf)"
            )

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """Return the result of `square_root.predict`."""
        return square_root.predict(belief, transition, noise_cov, self.rule)

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
        """Return the result of `square_root.update`."""
        measurement = np.asarray(measurement, dtype=float)
        check_noise(noise_cov, measurement.shape[-1], "measurement noise covariance")
        return square_root.update(
            belief, measurement, measure, noise_cov, self.rule, residual, gate
        )
