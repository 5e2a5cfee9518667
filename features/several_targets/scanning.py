"""A range-bearing sensor that misses targets and reports clutter; its detections have no names."""

import math
from dataclasses import dataclass

import numpy as np

from concord.features.several_targets.options import FALSE_ALARM, MOST_CLUTTER
from concord.plants.range_bearing import RangeBearing, wrapped

REFERENCE = math.sqrt(0.5)
"""Range at which the detection probability is the one asked for, in fields of view: half of the
field's area is nearer."""
_NOISE_BEYOND = 4
"""Standard deviations of noise that may take a detection beyond the field of view."""
LEAST_CLUTTER = 0.01
"""Expected clutter of a scan that a tracker assumes at least: none would make each detection a
target."""


@dataclass(frozen=True, eq=False)
class ScanningSensor:
    """One node's sensor: detections (D, 2) of range in m and bearing in rad.

    The detection probability of a Swerling I target is P^(1 / (1 + S)), where P is that of a false
    alarm. S, the ratio of echo and noise, falls with range r as r^-4. Source: Richards (2014),
    Fundamentals of radar signal processing, section 6.3. The detection probability is `detection`
    at 0.71 of the field of view, and 0 beyond the field. Clutter is Poisson and uniform over the
    field.

    Raises:
        ValueError: a detection probability or clutter that no sensor has.
    """

    sensor: RangeBearing  # position_m is (2,)
    detection: float = 0.9
    clutter: float = 5.0  # expected number of clutter detections in a scan
    field_of_view_m: float = 350.0
    speed_std_m_s: float = 10.0  # of each velocity of a target of which nothing is known
    reach_m: float = math.inf  # beyond it the scan that was received says nothing
    merge_m: float = 0.0  # detected targets at most so far apart give one detection

    def __post_init__(self) -> None:
        if not FALSE_ALARM < self.detection < 1:
            raise ValueError(
                f"detection {self.detection:g}: must be above {FALSE_ALARM:g}, the probability of "
                "a false alarm, and below 1; choose for example 0.9"
            )
        if not 0 <= self.clutter <= MOST_CLUTTER:
            raise ValueError(
                f"clutter {self.clutter:g}: must be 0 to {MOST_CLUTTER} detections in a scan"
            )
        if not 0 <= self.merge_m < math.inf:
            raise ValueError(f"merge_m {self.merge_m:g}: must be 0 m or more, and finite")

    @property
    def noise_cov(self) -> np.ndarray:
        """Covariance (2, 2) of a detection."""
        return np.diag(self.sensor.noise_std**2)

    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest range in m and bearing in rad of nearly all detections, (2,) each."""
        farthest = self.field_of_view_m + _NOISE_BEYOND * self.sensor.range_std_m
        return np.array([0.0, -math.pi]), np.array([farthest, math.pi])

    def measure(self, state: np.ndarray) -> np.ndarray:
        """Range and bearing (..., 2) of states (..., 4), without noise."""
        return self.sensor.measure(state, 0)

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., 2), its bearing within (-pi, pi]."""
        return self.sensor.residual(a, b)

    def detection_probability(self, state: np.ndarray) -> np.ndarray:
        """Return that of states (..., 4): (...); 0 beyond the field of view or the reach."""
        fields = self.measure(state)[..., 0] / self.field_of_view_m
        echo = math.log(FALSE_ALARM) / math.log(self.detection) - 1
        # 1 / (1 + S), written so that a target at the sensor divides by nothing.
        ratio = (fields / REFERENCE) ** 4
        probability = FALSE_ALARM ** (ratio / (ratio + echo))
        return np.where(fields > min(1.0, self.reach_m / self.field_of_view_m), 0.0, probability)

    def clutter_density(self, detections: np.ndarray) -> np.ndarray:
        """Return the expected clutter (D,) per m and rad: uniform over the area of the field."""
        # Noise may bring a range to 0 or below.
        ranges = np.maximum(detections[..., 0], self.sensor.range_std_m)
        return max(self.clutter, LEAST_CLUTTER) * ranges / (math.pi * self.field_of_view_m**2)

    def begun(self, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means (D, 4) and covariances (D, 4, 4) of targets that gave these detections.

        Raw range and bearing, linearised; the velocity is unknown, with mean 0.
        """
        ranges, cosine = detections[:, 0], np.cos(detections[:, 1])
        sine = np.sin(detections[:, 1])
        mean = np.zeros((len(detections), 4))
        mean[:, 0] = self.sensor.position_m[0] + ranges * cosine
        mean[:, 2] = self.sensor.position_m[1] + ranges * sine
        along = np.stack((cosine, sine), axis=-1) * self.sensor.range_std_m
        across = np.stack((-ranges * sine, ranges * cosine), axis=-1) * self.sensor.bearing_std_rad
        cov = np.zeros((len(detections), 4, 4))
        cov[:, ::2, ::2] = sum(side[:, :, None] * side[:, None, :] for side in (along, across))
        cov[:, 1, 1] = cov[:, 3, 3] = self.speed_std_m_s**2
        return mean, cov

    def scan(self, states: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Detections (D, 2) of targets at `states` (K, 4), NaN where none is, and of clutter.

        Each target takes three numbers of the generator, whether it is there or not; the order of
        the detections is random. Detected targets that `merge_m` links to each other give the
        detection of the mean of their states.
        """
        present = np.asarray(np.isfinite(states).all(axis=-1))
        chance, noise = generator.random(len(states)), generator.standard_normal((len(states), 2))
        there = np.where(present[:, None], states, 0.0)
        detected = present & (chance < self.detection_probability(there))
        exact, first = self._resolved(there[detected])
        taken = exact + noise[detected][first] * self.sensor.noise_std
        taken[:, 1] = wrapped(taken[:, 1])
        count = generator.poisson(self.clutter)
        uniform = generator.random((count, 2))
        clutter = np.stack(
            (
                self.field_of_view_m * np.sqrt(uniform[:, 0]),
                math.pi * (2 * uniform[:, 1] - 1),
            ),
            axis=-1,
        )
        return generator.permutation(np.concatenate((taken, clutter)))

    def _resolved(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return exact detections (D, 2) of detected targets, and the first target of each (D,)."""
        if self.merge_m <= 0:
            return self.measure(states), np.arange(len(states))
        places = states[:, ::2]
        linked = np.linalg.norm(places[:, None] - places, axis=-1) <= self.merge_m
        for _ in range(len(states)):
            linked = linked @ linked
        first = np.unique(linked.argmax(axis=1)) if len(states) else np.empty(0, dtype=int)
        groups = linked[first].astype(float)
        return self.measure(groups @ states / groups.sum(axis=1, keepdims=True)), first
