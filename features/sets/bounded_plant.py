"""A linear plant and sensors of the user's own, whose noise is unknown but bounded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from concord.features.sets.bounded import BoundedSystem
from concord.plants.own_values import covariance_of, require_description, vector_of

if TYPE_CHECKING:
    from concord.features.measurement_bus.measured import PlantOnBus

MatrixOrAt = ArrayLike | Callable[[int], ArrayLike]
"""A matrix, or a function of the step that gives it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BoundedPlant:
    """x(k + 1) = A x(k) + B w(k) with w' W^-1 w <= 1; the same w disturbs the sensors.

    Attributes:
        A: (n, n), or a function of the step.
        B: (n, q), or a function of the step.
        W: shape matrix (q, q) of the bound, or its diagonal (q,); positive definite.
        mean, shape: (n,) and (n, n) or (n,), the ellipsoid that holds the first state.
        time_step_s: sampling time.
        state_names, state_units: of each state; x0, x1, ... without units when left out.

    Raises:
        ValueError: shapes that do not fit, or a bound that is none.
    """

    A: MatrixOrAt
    B: MatrixOrAt
    W: ArrayLike
    mean: ArrayLike
    shape: ArrayLike
    time_step_s: float = 1.0
    state_names: tuple[str, ...] = ()
    state_units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, q = self.states, len(self.noise_shape)
        require_description(n, self.time_step_s, self.state_names, self.state_units)
        require_shape("A", self.transition(0), (n, n))
        require_shape("B", self.noise_input(0), (n, q))
        _ = self.prior_shape
        if np.linalg.eigvalsh(self.noise_shape).min() <= 0:
            raise ValueError("W: must be positive definite; leave out noise that is always 0")

    @property
    def states(self) -> int:
        """Number of states n."""
        return len(self.prior_mean)

    @cached_property
    def prior_mean(self) -> np.ndarray:
        """Centre (n,) of the ellipsoid of the first state."""
        return vector_of("mean", self.mean)

    @cached_property
    def prior_shape(self) -> np.ndarray:
        """Shape matrix (n, n) of the ellipsoid of the first state."""
        return covariance_of("shape", self.shape, self.states)

    @cached_property
    def noise_shape(self) -> np.ndarray:
        """W (q, q)."""
        return covariance_of("W", self.W)

    def transition(self, step: int) -> np.ndarray:
        """A (n, n) of a step."""
        return _at(self.A, step)

    def noise_input(self, step: int) -> np.ndarray:
        """B (n, q) of a step."""
        return _at(self.B, step)

    def on_a_bus(self, sensors: "Sequence[BoundedOutput]") -> "PlantOnBus":
        """Return the plant with its outputs behind a measurement bus.

        Raises:
            ValueError: sensors of another kind, or that do not fit the plant.
        """
        # Only here: a plant is described without a bus.
        from concord.features.measurement_bus.measured import plant_of_system
        from concord.features.sets.bounded_network import on_the_bound
        from concord.features.sets.bounded_on_a_bus import BoundedOnBus, as_gaussian, inside

        if any(not isinstance(sensor, BoundedOutput) for sensor in sensors):
            raise ValueError("sensors: a BoundedPlant takes BoundedOutput and no others")
        bounded = system_of(self, sensors)
        truth = BoundedOnBus(
            bounded,
            self.prior_mean,
            self.prior_shape,
            partial(on_the_bound, size=len(self.noise_shape)),
            inside,
            self.state_names or tuple(f"x{i}" for i in range(self.states)),
            self.state_units or ("",) * self.states,
            self.time_step_s,
        )
        return plant_of_system(truth, as_gaussian(bounded, self.states))._replace(bounded=bounded)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoundedOutput:
    """y(k) = C x(k) + D w(k), one number, with the noise w of the plant.

    Attributes:
        C: (n,), or a function of the step.
        D: (q,), or a function of the step.
    """

    C: MatrixOrAt
    D: MatrixOrAt

    def row(self, step: int) -> np.ndarray:
        """C (n,) of a step."""
        return _at(self.C, step)

    def noise_row(self, step: int) -> np.ndarray:
        """D (q,) of a step."""
        return _at(self.D, step)


def system_of(plant: BoundedPlant, sensors: Sequence[BoundedOutput]) -> BoundedSystem:
    """The plant with its sensors as outputs.

    Raises:
        ValueError: no sensor, or one whose rows do not fit the plant.
    """
    if not sensors:
        raise ValueError("sensors: give at least one BoundedOutput")
    for number, sensor in enumerate(sensors, start=1):
        require_shape(f"C of sensor {number}", sensor.row(0), (plant.states,))
        require_shape(f"D of sensor {number}", sensor.noise_row(0), (len(plant.noise_shape),))
    return BoundedSystem(
        transition=plant.transition,
        noise_input=plant.noise_input,
        output=lambda step: np.stack([sensor.row(step) for sensor in sensors]),
        feedthrough=lambda step: np.stack([sensor.noise_row(step) for sensor in sensors]),
        noise_shape=lambda _: plant.noise_shape,
    )


def require_shape(name: str, matrix: np.ndarray, shape: tuple[int, ...]) -> None:
    """Refuse a matrix of another shape, or with entries that are not finite."""
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise ValueError(f"{name} of shape {matrix.shape}: must be finite and of shape {shape}")


def _at(given: MatrixOrAt, step: int) -> np.ndarray:
    return np.asarray(given(step) if callable(given) else given, dtype=float)
