"""A sensor of the user's own, when it reads, and the sensors of a node as one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_trials import (
    Function,
    require_angles,
    require_dependence,
    require_lanes,
    require_one_value,
    within_a_turn,
)
from concord.plants.own_values import covariance_of, gate_threshold, vector_of

_ROUNDING = 1e-6  # of a step: an instant and a step that lie so near are the same


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnSensor:
    """y = h(x) + v, v normal with covariance R; also the model of its node's filter.

    Attributes:
        h: states (..., n) -> readings (..., m); it may take parameters of the plant by keyword.
        R: covariance of the noise, (m, m), its diagonal (m,), or one variance.
        angles: entries of the reading that are angles in rad; their differences are wrapped.
        gate: how likely a sound reading passes, from 0.7 to below 1, such as 0.99; or the
            chi-square threshold itself. The filter refuses what lies beyond it. None takes all.
        channels: name and unit of each entry, for reports and logs; may be left out.
        name: of the sensor in logs and messages; may be left out.
        every_s: time between its readings; None for one in each step.
        start_s: time of its first reading.
        delay_s: from a reading to its arrival at the node. Rule `labelled` puts late ones back.
        missing: probability that a reading is lost before the node has it.
        kinds: under which name `concord identify` has the noise of each entry; left to concord.

    Raises:
        ValueError: an R that is no covariance, angles that the reading does not have, a gate that
            would refuse half of the sound readings, or times below zero.
    """

    h: Callable[..., ArrayLike]
    R: ArrayLike
    angles: tuple[int, ...] = ()
    gate: float | None = None
    channels: tuple[tuple[str, str], ...] = ()
    name: str = ""
    every_s: float | None = None
    start_s: float = 0.0
    delay_s: float = 0.0
    missing: float = 0.0
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_angles(self.angles, self.entries, "entries")
        if self.gate is not None:
            object.__setattr__(self, "gate", gate_threshold(self.gate, self.entries))
        if self.channels and len(self.channels) != self.entries:
            raise ValueError(
                f"channels {self.channels}: must have {self.entries} pairs of name and unit, one "
                "for each entry of the reading"
            )
        for field, value in (("start_s", self.start_s), ("delay_s", self.delay_s)):
            if not 0 <= value < np.inf:
                raise ValueError(f"{field} {value}: must be 0 or more, and finite")
        if self.every_s is not None and not 0 < self.every_s < np.inf:
            raise ValueError(f"every_s {self.every_s}: must be above 0, and finite")
        if not 0 <= self.missing < 1:
            raise ValueError(f"missing {self.missing}: must be a probability, 0 or more, below 1")

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

    def due(self, steps: int, time_step_s: float) -> np.ndarray:
        """In which of the steps (steps,) it reads: those nearest to its instants."""
        places = np.arange(steps) - self.start_s / time_step_s
        if self.every_s is None:
            return places >= -0.5 - _ROUNDING
        period = self.every_s / time_step_s
        # The last instant that is not after half a step from here, and from the step before.
        last = np.floor((places + 0.5 + _ROUNDING) / period)
        return (last >= 0) & (last > np.floor((places - 0.5 + _ROUNDING) / period))

    def late_steps(self, time_step_s: float) -> int:
        """After how many steps its readings arrive."""
        return int(np.ceil(self.delay_s / time_step_s - _ROUNDING))


def joined(sensors: Sequence[OwnSensor]) -> OwnSensor:
    """The sensors of one node as one, whose reading has the entries of all.

    Raises:
        ValueError: one of several has a gate.
    """
    if len(sensors) == 1:
        one = sensors[0]
        return replace(one, channels=named_channels(one)) if one.name else one
    for one in sensors:
        if one.gate is not None:
            raise ValueError(
                f"sensor {one.name or 'with a gate'}: a gate judges all that a node reads; give "
                "the sensor with the gate a node of its own"
            )
    ends = np.cumsum([0, *(one.entries for one in sensors)])
    cov = np.zeros((ends[-1], ends[-1]))
    for one, first, last in zip(sensors, ends, ends[1:], strict=False):
        cov[first:last, first:last] = one.noise_cov
    pairs = zip(sensors, ends, strict=False)
    return OwnSensor(
        h=lambda x: np.concatenate([one.measure(x, 0) for one in sensors], axis=-1),
        R=cov,
        angles=tuple(int(first) + place for one, first in pairs for place in one.angles),
        channels=tuple(pair for one in sensors for pair in named_channels(one)),
        name=" and ".join(one.name for one in sensors if one.name),
        kinds=tuple(kind for one in sensors for kind in one.kinds),
    )


def named_channels(sensor: OwnSensor) -> tuple[tuple[str, str], ...]:
    """Name and unit of each entry; a sensor with a name has it before those of its channels."""
    names = sensor.channels or tuple((str(place), "") for place in range(sensor.entries))
    return tuple((f"{sensor.name} {name}".strip(), unit) for name, unit in names)


@dataclass(frozen=True, eq=False, kw_only=True)
class TrueSensor:
    """A sensor as it really is, where its node believes something else.

    Attributes:
        h: as that of `OwnSensor`; None for what the node believes.
        R: covariance of the noise, as that of `OwnSensor`; None for what the node believes.
        bias: added to each entry of a reading, (m,) or one number.
        outlier_share: part of the readings whose noise is `outlier_scale` times as large.
        outlier_scale: factor of the noise of outliers.
        degrees_of_freedom: of Student's t, which has heavy tails, scaled to the covariance R;
            above 2. Infinite for normal noise.

    Raises:
        ValueError: a share that is none, a scale of 0 or less, or 2 degrees of freedom or fewer.
    """

    h: Function | None = None
    R: ArrayLike | None = None
    bias: ArrayLike = 0.0
    outlier_share: float = 0.0
    outlier_scale: float = 20.0
    degrees_of_freedom: float = np.inf

    def __post_init__(self) -> None:
        vector_of("bias", self.bias)
        for name in ("outlier_share", "outlier_scale", "degrees_of_freedom"):
            if not isinstance(value := getattr(self, name), int | float | np.number):
                raise ValueError(f"{name} {value!r}: must be a number, such as 0.05")
        if not 0 <= self.outlier_share < 1:
            raise ValueError(f"outlier_share {self.outlier_share}: must be 0 or more, below 1")
        if not 0 < self.outlier_scale < np.inf:
            raise ValueError(f"outlier_scale {self.outlier_scale}: must be above 0, and finite")
        if not self.degrees_of_freedom > 2:
            raise ValueError(
                f"degrees_of_freedom {self.degrees_of_freedom}: must be above 2, for fewer have no "
                "variance"
            )

    def of(self, believed: OwnSensor) -> OwnSensor:
        """The sensor with this h and R in place of those that the node believes.

        Raises:
            ValueError: another number of entries than the node believes in.
        """
        noise = believed.R if self.R is None else self.R
        true = replace(believed, h=self.h or believed.h, R=noise, gate=None)
        if true.entries != believed.entries:
            raise ValueError(
                f"the true sensor has {true.entries} entries and the believed one "
                f"{believed.entries}; give both the same"
            )
        return true

    def shaped(self, normals: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Standard normals (steps, m) as noise with these tails, in units of its deviation."""
        steps = len(normals)
        if np.isfinite(self.degrees_of_freedom):
            freedom = self.degrees_of_freedom
            chi_square = generator.chisquare(freedom, (steps, 1))
            # Student's t has the variance freedom / (freedom - 2).
            normals = normals * np.sqrt((freedom - 2) / chi_square)
        outliers = generator.random((steps, 1)) < self.outlier_share
        return np.where(outliers, self.outlier_scale * normals, normals)


def require_sensor(sensor: OwnSensor, mean: np.ndarray, cov: np.ndarray, angles: tuple[int, ...]):
    """Refuse a sensor that cannot read states of this law, whose `angles` are angles.

    Raises:
        ValueError: an h of another shape or without leading axes, one that has one value for all
            states, or one that jumps by a turn in an entry that is not in its `angles`.
    """
    require_lanes("h(x)", sensor.h, mean, sensor.entries)
    require_dependence("h(x)", sensor.h, mean, cov, angles)
    require_one_value("h(x)", sensor.h, mean, cov, angles, sensor.angles)
