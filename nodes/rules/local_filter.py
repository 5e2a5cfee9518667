"""The part of every rule before any share is heard: predict, and take the node's own readings."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np

from concord.filters.filter import Filter, LearningFilter
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model as Points
from concord.filters.turns import angles_of, beside
from concord.filters.update import Update
from concord.nodes.messages import Measured


class Model(Protocol):
    """A filter's model of the plant."""

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., n) at `step + 1` from the state at `step`."""
        ...

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) of what the transition from `step` does not know."""
        ...


class Sensor(Protocol):
    """A node's model of its own readings."""

    @property
    def gate(self) -> float | None:
        """Chi-square threshold beyond which a reading is refused; None takes every reading."""
        ...

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """The reading (..., m) that a state (..., n) gives."""
        ...

    def residual(self, value: np.ndarray, predicted: np.ndarray, /) -> np.ndarray:
        """The difference of two readings (..., m), angles wrapped."""
        ...

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value (m,) and noise covariance (m, m) of a delivered reading (d,)."""
        ...


@runtime_checkable
class StateNoise(Protocol):
    """A model or a sensor with more noise the larger the state is: stochastic nonlinearities."""

    def state_noise_cov(self, belief: Gaussian, step: int) -> np.ndarray:
        """Covariance (..., d, d) that comes to the noise that does not depend on the state."""
        ...


class Memory(NamedTuple):
    """Memory of a filter about a sensor with readings (..., m) of a shape
    (`concord.filters.filter.LearningFilter`)."""

    shape: tuple[int, ...]
    learnt: Any


class LocalUpdate(NamedTuple):
    """Beliefs (..., n) after their readings, what the filter has learnt of each group's sensor, and
    how often what went wrong, by name: (...) integers.

    The memory is None before the first reading, and of a filter that learns nothing.
    """

    belief: Gaussian
    memory: tuple[Memory | None, ...]
    failures: dict[str, np.ndarray]


class Carried(NamedTuple):
    """Beliefs (K, n) at this step; `sound` (K,) is False where one could not be carried there."""

    beliefs: Gaussian
    sound: np.ndarray


def predict_to_step(
    beliefs: Gaussian, control: np.ndarray | None, step: int, model: Model, filter: Filter
) -> Carried:
    """Beliefs (..., n) of the step before, predicted to `step`, into which `control` drove."""
    noise_cov = with_state_noise(model.process_noise_cov(step - 1), model, beliefs, step - 1)
    moved = filter.predict(beliefs, transition_of(model, control, step - 1), noise_cov)
    return Carried(moved, finite_lanes(moved))


def transition_of(model: Model, control: np.ndarray | None, step: int) -> Points:
    """The model's transition of points (S, ..., n) from a step; angles that it gives are on the
    turn of those of the first point."""
    transition = partial(model.transition, control=control, step=step)
    angles = angles_of(model)
    if not angles:
        return transition

    def on_one_turn(points: np.ndarray) -> np.ndarray:
        values = transition(points)
        return beside(values, values[0], angles)

    return on_one_turn


def at(beliefs: Gaussian, place: int) -> Gaussian:
    """One (n,) of beliefs (K, n)."""
    return Gaussian(beliefs.mean[place], beliefs.cov[place])


def control_of(measured: Measured) -> np.ndarray | None:
    """Return the control that drove the plant into the step, (p,)."""
    return None if measured.control is None else np.array(measured.control)


def update_with_readings(
    belief: Gaussian,
    readings: np.ndarray,
    step: int,
    sensor: Sensor,
    filter: Filter,
    memory: Memory | None = None,
) -> LocalUpdate:
    """Beliefs (..., n) after their readings (..., r, d), one by one.

    A reading that is NaN throughout was not taken. `memory` is that of the sensor.
    """
    failures: dict[str, np.ndarray] = {}
    for place in range(readings.shape[-2]):
        delivered = readings[..., place, :]
        if np.isnan(delivered).all():
            continue
        interpreted = sensor.interpret(delivered)
        result, memory = update_and_learn(belief, memory, interpreted, step, sensor, filter)
        sound = finite_lanes(result.belief)
        _count(failures, "update-failed", ~sound)
        if sensor.gate is not None:
            _count(failures, "gated", sound & (result.normalised_innovation_squared > sensor.gate))
        belief = where(sound, result.belief, belief)
    return LocalUpdate(belief, (memory,), failures)


def update_and_learn(
    belief: Gaussian,
    memory: Memory | None,
    interpreted: tuple[np.ndarray, np.ndarray],
    step: int,
    sensor: Sensor,
    filter: Filter,
) -> tuple[Update, Memory | None]:
    """Beliefs (..., n) after one reading through the gate of its sensor, and the memory after it;
    None of a filter that learns nothing."""
    if not _learns(type(filter)):
        return update_with_reading(belief, interpreted, step, sensor, filter, sensor.gate), None
    learning = cast(LearningFilter[Any], filter)
    value, noise_cov = interpreted
    if memory is None:
        memory = Memory(value.shape, learning.begin(value.shape))
    result, learnt = learning.update_and_learn(
        belief,
        memory.learnt,
        value,
        partial(sensor.measure, step=step),
        with_state_noise(noise_cov, sensor, belief, step),
        residual=sensor.residual,
        gate=sensor.gate,
    )
    return result, memory._replace(learnt=learnt)


@lru_cache
def _learns(kind: type) -> bool:
    # Kept: to ask a protocol takes longer than to update.
    return issubclass(kind, LearningFilter)


def update_with_reading(
    belief: Gaussian,
    interpreted: tuple[np.ndarray, np.ndarray],
    step: int,
    sensor: Sensor,
    filter: Filter,
    gate: float | None = None,
) -> Update:
    """Beliefs (..., n) after one reading of values (..., m) and noise covariances (..., m, m),
    unless it lies beyond the gate."""
    value, noise_cov = interpreted
    return filter.update(
        belief,
        value,
        partial(sensor.measure, step=step),
        with_state_noise(noise_cov, sensor, belief, step),
        residual=sensor.residual,
        gate=gate,
    )


def failure_names(failures: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Return the name of each failure of a single lane, as often as it happened."""
    return tuple(name for name, count in failures.items() for _ in range(int(count.item())))


class SensorGroup(NamedTuple):
    """Nodes that one sensor value serves, an index into the second axis of the lanes; its arrays
    have one entry for each of them. All lanes where the index is `slice(None)`."""

    nodes: slice | np.ndarray
    sensor: Sensor

    @property
    def whole(self) -> bool:
        """Whether the group has all lanes."""
        return isinstance(self.nodes, slice) and self.nodes == slice(None)

    def of(self, values: np.ndarray) -> np.ndarray:
        """The values (R, K, ...) of the group, of those of all lanes (R, N, ...)."""
        return values if self.whole else values[:, self.nodes]

    def put(self, values: np.ndarray, changed_values: np.ndarray) -> np.ndarray:
        """The values (R, N, ...) of all lanes with those of the group (R, K, ...) replaced."""
        if self.whole:
            return changed_values
        changed = values.copy()
        changed[:, self.nodes] = changed_values
        return changed


@dataclass(frozen=True)
class LocalFilters:
    """The nodes' models of plant and sensors; nodes in no group are blind."""

    model: Model
    groups: tuple[SensorGroup, ...]
    filter: Filter

    def predict(
        self, belief: Gaussian, control: np.ndarray | None, step: int
    ) -> tuple[Gaussian, np.ndarray]:
        """Beliefs (R, N, n) of the step before at `step`, and where that went well (R, N)."""
        driven = None if control is None else control[:, None, :]
        moved, sound = predict_to_step(belief, driven, step, self.model, self.filter)
        return where(sound, moved, belief), sound

    def update(
        self,
        belief: Gaussian,
        readings: np.ndarray,
        step: int,
        memory: tuple[Memory | None, ...] = (),
    ) -> LocalUpdate:
        """Beliefs (..., n) after each node's own readings (..., r, d).

        The last axis of the lanes is that of the nodes where groups divide them. The memory has one
        entry for each group, and none before the first step.
        """
        if not self.groups:
            return LocalUpdate(belief, (), {})
        before = memory or (None,) * len(self.groups)
        if len(self.groups) == 1 and self.groups[0].whole:
            sensor = self.groups[0].sensor
            return update_with_readings(belief, readings, step, sensor, self.filter, before[0])
        mean, cov = belief.mean.copy(), belief.cov.copy()
        counted: dict[str, np.ndarray] = {}
        learnt: tuple[Memory | None, ...] = ()
        for (nodes, sensor), known in zip(self.groups, before, strict=True):
            own = Gaussian(belief.mean[:, nodes], belief.cov[:, nodes])
            after, found, failures = update_with_readings(
                own, readings[:, nodes], step, sensor, self.filter, known
            )
            mean[:, nodes], cov[:, nodes] = after
            learnt += found
            for name, count in failures.items():
                total = counted.setdefault(name, np.zeros(mean.shape[:2], dtype=int))
                total[:, nodes] += count
        return LocalUpdate(Gaussian(mean, cov), learnt, counted)


def _count(failures: dict[str, np.ndarray], name: str, lanes: np.ndarray) -> None:
    if lanes.any():
        failures[name] = failures.get(name, 0) + lanes.astype(int)


def where(chosen: np.ndarray, one: Gaussian, other: Gaussian) -> Gaussian:
    """`one` in the lanes (...) that are chosen, `other` elsewhere."""
    if chosen.all():
        return one
    return Gaussian(
        np.where(chosen[..., None], one.mean, other.mean),
        np.where(chosen[..., None, None], one.cov, other.cov),
    )


def finite_lanes(beliefs: Gaussian) -> np.ndarray:
    """Where every number of a belief is finite: (...) bool."""
    if finite(beliefs):
        return np.ones(beliefs.mean.shape[:-1], dtype=bool)
    finite_mean = np.isfinite(beliefs.mean).all(axis=-1)
    return np.logical_and(finite_mean, np.isfinite(beliefs.cov).all(axis=(-1, -2)))


def finite(belief: Gaussian) -> bool:
    """Whether every number of all beliefs (..., n) is finite."""
    return _all_finite(belief.mean) and _all_finite(belief.cov)


def _all_finite(values: np.ndarray) -> bool:
    # A sum of squares takes a third of the time, and is infinite for large numbers as well.
    flat = values.ravel(order="K")  # in the order of memory: nothing is copied
    return math.isfinite(flat.dot(flat)) or bool(np.isfinite(flat).all())


def with_state_noise(
    noise_cov: np.ndarray, owner: object, belief: Gaussian, step: int
) -> np.ndarray:
    """Noise covariance of a model or a sensor, with what comes to it at a belief."""
    if _has_state_noise(type(owner)):
        return noise_cov + cast(StateNoise, owner).state_noise_cov(belief, step)
    return noise_cov


@lru_cache
def _has_state_noise(kind: type) -> bool:
    # Kept: to ask a protocol takes longer than to add the noise.
    return issubclass(kind, StateNoise)
