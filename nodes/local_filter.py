"""What every rule does before it hears anybody: predict, and take the node's own readings."""

from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule
from filters.ukf import predict, update
from nodes.messages import Array, Measured, from_wire


class Model(Protocol):
    """What a filter believes of the plant."""

    def transition(self, state: Array, control: Array | None, step: int) -> Array:
        """State (..., n) at `step + 1` from the state at `step`."""
        ...

    def process_noise_cov(self, step: int) -> Array:
        """Covariance (n, n) of what the transition from `step` does not know."""
        ...


class Sensor(Protocol):
    """What a node believes of its own readings."""

    @property
    def gate(self) -> float | None:
        """Chi-square threshold beyond which a reading is refused; None takes every reading."""
        ...

    def measure(self, state: Array, step: int) -> Array:
        """The reading (..., m) that a state (..., n) gives."""
        ...

    def residual(self, value: Array, predicted: Array, /) -> Array:
        """The difference of two readings (..., m), angles wrapped."""
        ...

    def interpret(self, delivered: Array) -> tuple[Array, Array]:
        """Value (m,) and noise covariance (m, m) of a delivered reading (d,)."""
        ...


@runtime_checkable
class StateNoise(Protocol):
    """A model or a sensor with more noise the larger the state is: stochastic nonlinearities."""

    def state_noise_cov(self, belief: Gaussian, step: int) -> Array:
        """Covariance (..., d, d) that comes to the noise that does not depend on the state."""
        ...


class Carried(NamedTuple):
    """Beliefs (K, n) at this step; `sound` (K,) is False where one could not be carried there."""

    beliefs: Gaussian
    sound: np.ndarray

    def at(self, place: int) -> Gaussian:
        """One of them."""
        return Gaussian(self.beliefs.mean[place], self.beliefs.cov[place])


def carry(
    beliefs: list[Gaussian], measured: Measured, model: Model, points: SigmaPointRule
) -> Carried:
    """Beliefs of the step before, predicted to that of `measured`."""
    control = None if measured.control is None else np.array(measured.control)
    step = measured.step - 1
    # One call for all of them: the plant's functions cost more to enter than to evaluate.
    stacked = Gaussian(np.stack([b.mean for b in beliefs]), np.stack([b.cov for b in beliefs]))
    noise_cov = _with_state_noise(model.process_noise_cov(step), model, stacked, step)
    moved = predict(
        stacked, partial(model.transition, control=control, step=step), noise_cov, points
    )
    return Carried(moved, finite_lanes(moved))


def take_readings(
    belief: Gaussian, measured: Measured, sensor: Sensor | None, points: SigmaPointRule
) -> tuple[Gaussian, list[str]]:
    """The belief after the own readings, one by one, and the names of what went wrong."""
    troubles: list[str] = []
    for delivered in from_wire(measured.readings):
        if sensor is None or np.isnan(delivered).all():
            continue
        value, noise_cov = sensor.interpret(delivered)
        noise_cov = _with_state_noise(noise_cov, sensor, belief, measured.step)
        result = update(
            belief,
            value,
            partial(sensor.measure, step=measured.step),
            noise_cov,
            points,
            residual=sensor.residual,
            gate=sensor.gate,
        )
        if not finite(result.belief):
            troubles.append("update-failed")
            continue
        belief = result.belief
        if sensor.gate is not None and result.normalised_innovation_squared > sensor.gate:
            troubles.append("gated")
    return belief, troubles


def finite_lanes(beliefs: Gaussian) -> np.ndarray:
    """Where every number of a belief is finite: (...) bool."""
    finite_mean = np.isfinite(beliefs.mean).all(axis=-1)
    return np.logical_and(finite_mean, np.isfinite(beliefs.cov).all(axis=(-1, -2)))


def finite(belief: Gaussian) -> bool:
    """Whether every number of one belief is finite."""
    return bool(finite_lanes(belief))


def _with_state_noise(noise_cov: Array, owner: object, belief: Gaussian, step: int) -> Array:
    """Noise covariance of a model or a sensor, with what comes to it at a belief."""
    if isinstance(owner, StateNoise):
        return noise_cov + owner.state_noise_cov(belief, step)
    return noise_cov
