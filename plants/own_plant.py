"""A plant and sensors of the user's own, as plain functions and covariances."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_trials import (
    Function,
    require_angles,
    require_dependence,
    require_finite,
    require_lanes,
    require_one_value,
    within_a_turn,
)
from concord.plants.own_values import (
    covariance_of,
    gate_threshold,
    numbers_of,
    require_description,
    vector_of,
)
from concord.plants.placement import Draws, GeneratorFor, standard_draws


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnSensor:
    """y = h(x) + v, v normal with covariance R; also the model of its node's filter.

    Attributes:
        h: states (..., n) -> readings (..., m).
        R: covariance of the noise, (m, m), its diagonal (m,), or one variance.
        angles: entries of the reading that are angles in rad; their differences are wrapped.
        gate: how likely a sound reading passes, from 0.7 to below 1, such as 0.99; or the
            chi-square threshold itself. The filter refuses what lies beyond it. None takes all.
        channels: name and unit of each entry, for reports; may be left out.

    Raises:
        ValueError: an R that is no covariance, angles that the reading does not have, or a gate
            that would refuse half of the sound readings.
    """

    h: Function
    R: ArrayLike
    angles: tuple[int, ...] = ()
    gate: float | None = None
    channels: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        require_angles(self.angles, self.entries, "entries")
        if self.gate is not None:
            object.__setattr__(self, "gate", gate_threshold(self.gate, self.entries))

    @property
    def entries(self) -> int:
        """Number of entries m of a reading."""
        return len(self.noise_cov)

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance (m, m) of the noise."""
        return covariance_of("R", self.R)

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviation (m,) of the noise of each entry."""
        return np.sqrt(np.maximum(np.diagonal(self.noise_cov), 0))

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Readings (..., m) of states (..., n), without noise."""
        return np.asarray(self.h(state), dtype=float)

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Differences a - b (..., m), angles within (-pi, pi]."""
        return within_a_turn(np.subtract(a, b), self.angles)

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value (..., m) and noise covariance (..., m, m) of a delivered reading (..., d)."""
        value = delivered[..., : self.entries]
        return value, np.broadcast_to(self.noise_cov, (*value.shape, self.entries))


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnPlant:
    """x(k + 1) = f(x(k)) + w, w normal with covariance Q; also the model of the nodes' filters.

    Attributes:
        f: states (..., n) -> (..., n), one step later.
        Q: covariance of the process noise of a step, (n, n), or its diagonal (n,).
        mean, cov: law of the first state and prior of every filter, (n,) and (n, n) or (n,).
        time_step_s: sampling time.
        state_names, state_units: of each state; x0, x1, ... without units when left out.
        positions: places of the nodes in m, (nodes, 2), for geometric graphs and pictures.
        angles: states that are angles in rad. f and h get them within (-pi, pi], and f may return
            them on any turn. Recorded states count turns, so that they have no jumps.

    Raises:
        ValueError: shapes that do not fit, a matrix that is no covariance, or an f that does not
            keep leading axes. An f that jumps by a turn in a state that is not in `angles`.
    """

    f: Function
    Q: ArrayLike
    mean: ArrayLike
    cov: ArrayLike
    time_step_s: float = 1.0
    state_names: tuple[str, ...] = ()
    state_units: tuple[str, ...] = ()
    positions: ArrayLike | None = None
    angles: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        n = self.states
        require_description(n, self.time_step_s, self.state_names, self.state_units)
        require_angles(self.angles, n, "states")
        law = self.prior_mean, self.prior_cov
        _ = self.noise_cov, self.places
        require_lanes("f", self.f, self.prior_mean, n)
        require_finite("f(x)", self.f, *law)
        require_one_value("f(x)", self.f, *law, self.angles, self.angles)

    @property
    def states(self) -> int:
        """Number of states n."""
        return len(self.prior_mean)

    @cached_property
    def prior_mean(self) -> np.ndarray:
        """Mean (n,) of the first state."""
        return vector_of("mean", self.mean)

    @cached_property
    def prior_cov(self) -> np.ndarray:
        """Covariance (n, n) of the first state."""
        return covariance_of("cov", self.cov, self.states)

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance (n, n) of the process noise."""
        return covariance_of("Q", self.Q, self.states)

    @cached_property
    def places(self) -> np.ndarray | None:
        """Places (nodes, 2) of the nodes in m; None where the user named none."""
        if self.positions is None:
            return None
        places = numbers_of("positions", self.positions)
        if places.ndim != 2 or places.shape[1] != 2 or not np.isfinite(places).all():
            raise ValueError(
                f"positions of shape {places.shape}: must be (nodes, 2), two finite numbers in m"
            )
        return places

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., n) one step later, without noise; angles less than half a turn away."""
        moved = np.asarray(self.f(within_a_turn(state, self.angles)), dtype=float)
        if not self.angles:
            return moved
        changed = within_a_turn(moved - state, self.angles)
        places = list(self.angles)
        turned = moved.copy()
        turned[..., places] = (state + changed)[..., places]
        return turned

    def seen_by(self, sensor: OwnSensor) -> OwnSensor:
        """The same sensor, whose h gets angles within (-pi, pi]."""
        if not self.angles:
            return sensor
        return replace(sensor, h=lambda x: sensor.h(within_a_turn(x, self.angles)))

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) that a step adds."""
        return self.noise_cov


@dataclass(frozen=True, eq=False)
class OwnTruth:
    """The truth of an own plant, seen by one sensor for each node; None for a blind node."""

    plant: OwnPlant
    sensors: tuple[OwnSensor | None, ...]

    @property
    def time_step_s(self) -> float:
        """Sampling time."""
        return self.plant.time_step_s

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.plant.state_names or tuple(f"x{i}" for i in range(self.plant.states))

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the states; "" where the user named none."""
        return self.plant.state_units or ("",) * self.plant.states

    @cached_property
    def _entries(self) -> int:
        return max((one.entries for one in self.sensors if one is not None), default=1)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        return _factor(self.plant.prior_cov), _factor(self.plant.noise_cov)

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run."""
        n = self.plant.states
        return standard_draws(generator_for, n, n, (len(self.sensors), 1, self._entries), steps)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., n), prior mean (..., n) and prior cov (n, n) for noise (..., n)."""
        mean = np.broadcast_to(self.plant.prior_mean, noise.shape).copy()
        return mean + noise @ self._factors[0].T, mean, self.plant.prior_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """True states (..., n) one step later, for noise (..., n)."""
        return self.plant.transition(state, control, step) + noise @ self._factors[1].T

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Readings (..., nodes, 1, d) of states (..., n); NaN where a node has no such entry."""
        readings = np.full(noise.shape, np.nan)
        for node, sensor in enumerate(self.sensors):
            if sensor is not None:
                m = sensor.entries
                error = noise[..., node, 0, :m] @ _factor(sensor.noise_cov).T
                reading = sensor.measure(state, step) + error
                readings[..., node, 0, :m] = within_a_turn(reading, sensor.angles)
        return readings

    def positions(self, step: int) -> np.ndarray | None:
        """Return the nodes' places (nodes, 2) in m; None where the user named none."""
        places = self.plant.places
        if places is None:
            return None
        if len(places) != len(self.sensors):
            raise ValueError(
                f"positions of shape {places.shape}: must be ({len(self.sensors)}, 2), a place for "
                "each node"
            )
        return places


def require_sensors(plant: OwnPlant, sensors: Sequence[OwnSensor | None]) -> None:
    """Refuse sensors that cannot read the states of a plant.

    Raises:
        ValueError: no sensor at all, an h of another shape or without leading axes, or one that
            jumps by a turn in an entry that is not in its `angles`.
    """
    if not isinstance(sensors, Sequence) or isinstance(sensors, str):
        raise ValueError(
            f"sensors of type {type(sensors).__name__}: must be a list, such as "
            "[OwnSensor(...), None]"
        )
    for place, sensor in enumerate(sensors):
        if sensor is not None and not isinstance(sensor, OwnSensor):
            raise ValueError(
                f"sensors: entry {place} is of type {type(sensor).__name__}; it must be an "
                "OwnSensor, or None for a blind node"
            )
    if not any(sensor is not None for sensor in sensors):
        raise ValueError("sensors: none of the nodes has one; give at least one OwnSensor")
    for sensor in sensors:
        if sensor is not None:
            require_lanes("h", sensor.h, plant.prior_mean, sensor.entries)
            law = plant.prior_mean, plant.prior_cov
            require_dependence("h(x)", sensor.h, *law, plant.angles)
            require_one_value("h(x)", sensor.h, *law, plant.angles, sensor.angles)


def _factor(cov: np.ndarray) -> np.ndarray:
    """A factor of a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0))
