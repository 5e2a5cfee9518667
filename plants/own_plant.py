"""A plant and sensors of the user's own, as plain functions and covariances."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.placement import Draws, GeneratorFor, standard_draws

# Leading axes with which a function is tried before anything starts.
_TRIED = (3, 2)

Function = Callable[[np.ndarray], ArrayLike]
"""A function of states (..., n) that keeps their leading axes."""


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

    Raises:
        ValueError: shapes that do not fit, a matrix that is no covariance, or an f that does not
            keep leading axes.
    """

    f: Function
    Q: ArrayLike
    mean: ArrayLike
    cov: ArrayLike
    time_step_s: float = 1.0
    state_names: tuple[str, ...] = ()
    state_units: tuple[str, ...] = ()
    positions: ArrayLike | None = None

    def __post_init__(self) -> None:
        n = self.states
        require_description(n, self.time_step_s, self.state_names, self.state_units)
        _ = self.prior_cov, self.noise_cov
        _require_lanes("f", self.f, self.prior_mean, n)

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

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., n) one step later, without noise."""
        return np.asarray(self.f(state), dtype=float)

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) that a step adds."""
        return self.noise_cov


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnSensor:
    """y = h(x) + v, v normal with covariance R; also the model of its node's filter.

    Attributes:
        h: states (..., n) -> readings (..., m).
        R: covariance of the noise, (m, m), its diagonal (m,), or one variance.
        angles: entries of the reading that are angles in rad; their differences are wrapped.
        gate: chi-square threshold beyond which the filter refuses a reading; None takes all.
        channels: name and unit of each entry, for reports; may be left out.

    Raises:
        ValueError: an R that is no covariance, or angles that the reading does not have.
    """

    h: Function
    R: ArrayLike
    angles: tuple[int, ...] = ()
    gate: float | None = None
    channels: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if any(not 0 <= entry < self.entries for entry in self.angles):
            raise ValueError(
                f"angles {self.angles}: the reading has entries 0 to {self.entries - 1}"
            )

    @property
    def entries(self) -> int:
        """Number of entries m of a reading."""
        return len(self.noise_cov)

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance (m, m) of the noise."""
        return covariance_of("R", self.R, np.atleast_1d(np.asarray(self.R)).shape[0])

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviation (m,) of the noise of each entry."""
        return np.sqrt(np.maximum(np.diagonal(self.noise_cov), 0))

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Readings (..., m) of states (..., n), without noise."""
        return np.asarray(self.h(state), dtype=float)

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Differences a - b (..., m), angles wrapped to [-pi, pi)."""
        difference = np.subtract(a, b)
        for entry in self.angles:
            difference[..., entry] = (difference[..., entry] + np.pi) % (2 * np.pi) - np.pi
        return difference

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value (..., m) and noise covariance (..., m, m) of a delivered reading (..., d)."""
        value = delivered[..., : self.entries]
        return value, np.broadcast_to(self.noise_cov, (*value.shape, self.entries))


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
                readings[..., node, 0, :m] = sensor.measure(state, step) + error
        return readings

    def positions(self, step: int) -> np.ndarray | None:
        """Return the nodes' places (nodes, 2) in m; None where the user named none."""
        if self.plant.positions is None:
            return None
        places = np.asarray(self.plant.positions, dtype=float)
        if places.shape != (len(self.sensors), 2):
            raise ValueError(
                f"positions of shape {places.shape}: must be ({len(self.sensors)}, 2), a place for "
                "each node"
            )
        return places


def require_sensors(plant: OwnPlant, sensors: Sequence[OwnSensor | None]) -> None:
    """Refuse sensors that cannot read the states of a plant.

    Raises:
        ValueError: no sensor at all, or an h of another shape or without leading axes.
    """
    if not any(sensor is not None for sensor in sensors):
        raise ValueError("sensors: none of the nodes has one; give at least one OwnSensor")
    for sensor in sensors:
        if sensor is not None:
            _require_lanes("h", sensor.h, plant.prior_mean, sensor.entries)


def _require_lanes(name: str, function: Function, mean: np.ndarray, entries: int) -> None:
    """Try a function on lanes of states, and on each of them alone."""
    lanes = mean + np.linspace(0, 0.1, 6).reshape(*_TRIED, 1)
    try:
        together = np.asarray(function(lanes), dtype=float)
    except Exception as error:
        raise ValueError(
            f"{name}(x) with x of shape {lanes.shape} fails ({type(error).__name__}: {error}); "
            "leading axes are free, so write x[..., 0] for the first state"
        ) from error
    if together.shape != (*_TRIED, entries):
        raise ValueError(
            f"{name}(x) with x of shape {lanes.shape} has shape {together.shape}: must be "
            f"{(*_TRIED, entries)}; leading axes are free, so write x[..., 0] for the first state, "
            "and join results with np.stack((a, b), axis=-1)"
        )
    for lane in np.ndindex(*_TRIED):
        alone = np.asarray(function(lanes[lane]), dtype=float)
        if not np.allclose(alone, together[lane], equal_nan=True):
            raise ValueError(
                f"{name}(x) of one state differs from {name}(x) of several at once: it mixes the "
                "lanes; write x[..., 0] for the first state"
            )


def require_description(
    states: int, time_step_s: float, names: Sequence[str], units: Sequence[str]
) -> None:
    """Refuse a time step of 0 or less, and names or units that are not those of all states."""
    if not time_step_s > 0:
        raise ValueError(f"time_step_s {time_step_s}: must be above 0")
    for field, given in (("state_names", names), ("state_units", units)):
        if given and len(given) != states:
            raise ValueError(f"{field} {given}: must have {states} entries, one for each state")


def vector_of(name: str, given: ArrayLike) -> np.ndarray:
    """Return a vector (n,) of finite numbers; `name` is that of the argument in messages."""
    vector = np.atleast_1d(np.asarray(given, dtype=float))
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise ValueError(f"{name} {given}: must be a vector of finite numbers")
    return vector


def covariance_of(name: str, given: ArrayLike, size: int) -> np.ndarray:
    """Return a covariance (size, size) of a matrix or its diagonal; `name` as in `vector_of`."""
    matrix = np.asarray(given, dtype=float)
    if matrix.ndim < 2:
        matrix = np.diag(np.atleast_1d(matrix))
    if matrix.shape != (size, size):
        raise ValueError(
            f"{name} of shape {np.shape(given)}: must be {(size, size)}, or its diagonal {(size,)}"
        )
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
        raise ValueError(f"{name}: must be finite and symmetric")
    if np.linalg.eigvalsh(matrix).min() < -1e-12 * max(1.0, np.abs(matrix).max()):
        raise ValueError(f"{name}: has a negative eigenvalue; a covariance has none")
    return matrix


def _factor(cov: np.ndarray) -> np.ndarray:
    """A factor of a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0))


def from_control(
    system: Any,
    *,
    Q: ArrayLike,
    R: ArrayLike,
    mean: ArrayLike,
    cov: ArrayLike,
    time_step_s: float | None = None,
) -> tuple[OwnPlant, OwnSensor]:
    """The plant and the sensor of a `control.StateSpace`, without its inputs.

    Args:
        system: a linear system; a continuous one is sampled at `time_step_s`.
        Q: covariance of the process noise of a step, (n, n) or (n,).
        R: covariance of the noise of its outputs, (m, m) or (m,).
        mean, cov: law of the first state, as in `OwnPlant`.
        time_step_s: sampling time; that of the system when left out.

    Raises:
        ValueError: a system without a sampling time, or one of another than `time_step_s`.
    """
    is_continuous = system.dt in (None, 0, True)
    if is_continuous and time_step_s is None:
        raise ValueError("the system has no sampling time; give time_step_s")
    if not is_continuous and time_step_s not in (None, system.dt):
        raise ValueError(
            f"time_step_s {time_step_s}: the system is sampled at {system.dt} s; leave it out"
        )
    if system.dt == 0:
        system = system.sample(time_step_s)
    transition, output = np.asarray(system.A, dtype=float), np.asarray(system.C, dtype=float)
    sampled_s = float(system.dt) if not is_continuous else float(time_step_s or 0)
    names = tuple(map(str, getattr(system, "state_labels", None) or ()))
    plant = OwnPlant(
        f=lambda x: x @ transition.T,
        Q=Q,
        mean=mean,
        cov=cov,
        time_step_s=sampled_s,
        state_names=names,
    )
    return plant, OwnSensor(h=lambda x: x @ output.T, R=R)
