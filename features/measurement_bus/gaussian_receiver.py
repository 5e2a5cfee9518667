"""A Gaussian filter at the receiver of a measurement bus."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from concord.features.measurement_bus.stochastic_ukf import (
    Dynamics,
    MeasurementFilter,
    Observation,
    Received,
    SecondMoment,
)
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule


class System(Protocol):
    """Model of the plant for a filter behind a measurement bus (see
    `concord.features.measurement_bus.stochastic`)."""

    @property
    def sizes(self) -> tuple[int, ...]: ...

    @property
    def transition(self) -> Callable[[np.ndarray, np.ndarray | None, int], np.ndarray]: ...

    @property
    def measure(self) -> Callable[[np.ndarray, int], np.ndarray]: ...

    @property
    def process_noise_cov(self) -> Callable[[int], np.ndarray]: ...

    @property
    def measurement_noise_cov(self) -> Callable[[int], np.ndarray]: ...

    def process_moment(self, step: int) -> SecondMoment: ...

    def measurement_moment(self, step: int) -> SecondMoment: ...


def dynamics(system: System, control: np.ndarray | None, step: int) -> Dynamics:
    """Return the dynamics of the state from `step` to the next."""
    return Dynamics(
        lambda points: system.transition(points, control, step),
        system.process_noise_cov(step),
        system.process_moment(step),
    )


def observation(system: System, step: int) -> Observation:
    """Return the observation of the sensors at `step`."""
    return Observation(
        lambda points: system.measure(points, step),
        system.measurement_noise_cov(step),
        system.measurement_moment(step),
    )


@dataclass(frozen=True)
class GaussianReceiver:
    """A filter, its system, its points and its prior.

    The interface is `concord.features.measurement_bus.reception.Receiver`.
    """

    system: System
    filter: MeasurementFilter
    points: SigmaPointRule
    prior: Gaussian

    @property
    def failure(self) -> str:
        """Return the word that is counted where an update fails."""
        return "update-failed"

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the lengths of the sensors' measurements."""
        return self.system.sizes

    def start(self, lanes: tuple[int, ...] = ()) -> Any:
        """Return the state at step 0, one of each lane."""
        n = self.prior.mean.shape[-1]
        prior = Gaussian(
            np.broadcast_to(self.prior.mean, (*lanes, n)),
            np.broadcast_to(self.prior.cov, (*lanes, n, n)),
        )
        return self.filter.start(prior, observation(self.system, 0), self.points)

    def predict(self, state: Any, control: np.ndarray | None, step: int) -> Any:
        """Return the state at `step`, of that at the step before."""
        return self.filter.predict(state, dynamics(self.system, control, step - 1), self.points)

    def update(self, state: Any, received: Received, step: int) -> Any:
        """Return the state after the slot of a step."""
        return self.filter.update(state, received, observation(self.system, step), self.points)

    def belief(self, state: Any) -> Gaussian:
        """Return the belief of the filter."""
        return state.belief

    def generators(self, state: Any) -> None:
        """Return None: a Gaussian belief is no zonotope."""

    def gap(self, state: Any) -> np.ndarray:
        """Return NaN: no programme is solved."""
        return np.array(np.nan)
