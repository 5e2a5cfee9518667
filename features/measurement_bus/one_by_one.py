"""A receiver of a measurement bus whose runs are computed one after the other.

The programme that finds the least ellipsoid ends its iterations for all its lanes together, so a
lane differs by some 1e-10 from the same one alone. Drivers have to agree more closely.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from concord.features.measurement_bus.reception import Receiver
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.filters.gaussian import Gaussian


@dataclass(frozen=True)
class OneByOne:
    """`Receiver` of R runs; its state has that of each run."""

    receiver: Receiver

    @property
    def failure(self) -> str:
        """Return the word that is counted where an update fails."""
        return self.receiver.failure

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the lengths of the sensors' measurements."""
        return self.receiver.sizes

    def start(self, lanes: tuple[int, ...] = ()) -> tuple[Any, ...]:
        """Return the states at step 0 of R runs, `lanes` (R,)."""
        (runs,) = lanes
        return (self.receiver.start(),) * runs

    def predict(
        self, state: tuple[Any, ...], control: np.ndarray | None, step: int
    ) -> tuple[Any, ...]:
        """Return the states at `step`."""
        driven = [None] * len(state) if control is None else control
        return tuple(
            self.receiver.predict(one, own, step) for one, own in zip(state, driven, strict=True)
        )

    def update(self, state: tuple[Any, ...], received: Received, step: int) -> tuple[Any, ...]:
        """Return the states after the slot of a step."""
        return tuple(
            self.receiver.update(one, Received(*own), step)
            for one, *own in zip(state, *received, strict=True)
        )

    def belief(self, state: tuple[Any, ...]) -> Gaussian:
        """Return the beliefs: mean (R, n), cov (R, n, n)."""
        return Gaussian(*map(np.stack, zip(*map(self.receiver.belief, state), strict=True)))

    def generators(self, state: tuple[Any, ...]) -> None:
        """Return None: arrays of runs have no place for generators."""

    def gap(self, state: tuple[Any, ...]) -> np.ndarray:
        """Return the duality gaps (R,) of the sets relative to their traces; NaN for none."""
        return np.array([self.receiver.gap(one) for one in state])
