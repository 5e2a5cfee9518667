"""A filter over a sliding window: records may come late and in any order, and each counts once.

A `Window` is a value: the belief at its base, the labelled records of the steps after it, and the
posteriors that are still right. A change of a step drops the posteriors from there on; `filtered`
computes them anew.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule
from filters.ukf import update
from nodes.messages import Measured
from nodes.rules.local_filter import Model, Sensor, StateNoise, control_of, finite, predict_to_step
from nodes.rules.record_codec import RecordCodec

# More than a window of most networks holds.
_KEPT_RECORDS = 4096


class Window(NamedTuple):
    """A node's records and beliefs of the steps after `base_step`.

    Attributes:
        base_step, base: the belief that everything older went into; -1 is the prior, to which no
            prediction leads: it is the belief at step 0 before any reading.
        heartbeats: of the steps after `base_step`, ascending: what drove the plant.
        records: per step, what was taken by which source.
        posteriors: of the steps after `base_step`, as far as they are right.
    """

    base_step: int
    base: Gaussian
    heartbeats: tuple[Measured, ...]
    records: tuple[Mapping[int, bytes], ...]
    posteriors: tuple[Gaussian, ...]

    @property
    def step(self) -> int:
        """The last step."""
        return self.base_step + len(self.heartbeats)

    @property
    def belief(self) -> Gaussian:
        """The newest posterior there is."""
        return self.posteriors[-1] if self.posteriors else self.base


def empty_window(base_step: int, base: Gaussian) -> Window:
    """A window of no steps."""
    return Window(base_step, base, (), (), ())


def opened(window: Window, heartbeat: Measured) -> Window:
    """With one step more."""
    return window._replace(
        heartbeats=(*window.heartbeats, heartbeat), records=(*window.records, {})
    )


def shortened(window: Window) -> Window:
    """With its first step in the base; that step has a posterior."""
    return Window(
        window.base_step + 1,
        window.posteriors[0],
        window.heartbeats[1:],
        window.records[1:],
        window.posteriors[1:],
    )


def with_records(window: Window, new: Mapping[int, Mapping[int, bytes]]) -> Window:
    """With new records by step and source, all of steps in the window and none held before."""
    if not new:
        return window
    records = list(window.records)
    for step, by_source in new.items():
        place = step - window.base_step - 1
        # By source: the order in which they came must not decide the bits of the update.
        records[place] = dict(sorted({**records[place], **by_source}.items()))
    right = min(new) - window.base_step - 1
    return window._replace(records=tuple(records), posteriors=window.posteriors[:right])


def with_base(window: Window, base: Gaussian) -> Window:
    """With another belief at the base."""
    return window._replace(base=base, posteriors=())


@dataclass(frozen=True)
class WindowFilter:
    """Knowledge common to all nodes: the plant, and the sensor and records of each node.

    Raises nothing for a record that cannot be used: its step keeps the prediction.
    """

    model: Model
    sensors: Sequence[Sensor | None]
    codecs: Sequence[RecordCodec | None]
    points: SigmaPointRule

    def filtered(self, window: Window) -> tuple[Window, tuple[str, ...]]:
        """The window with the posteriors of all its steps, and the names of what went wrong."""
        posteriors = list(window.posteriors)
        failures: list[str] = []
        belief = window.belief
        for place in range(len(posteriors), len(window.heartbeats)):
            belief, predicted = self.predicted(belief, window.heartbeats[place])
            belief, updated = self._updated(belief, window.records[place], window, place)
            failures += (*predicted, *updated)
            posteriors.append(belief)
        return window._replace(posteriors=tuple(posteriors)), tuple(failures)

    def predicted(self, belief: Gaussian, heartbeat: Measured) -> tuple[Gaussian, tuple[str, ...]]:
        """The posterior of the step before, carried to that of the heartbeat."""
        if heartbeat.step == 0:
            return belief, ()
        control = control_of(heartbeat)
        carried = predict_to_step(belief, control, heartbeat.step, self.model, self.points)
        return (carried.beliefs, ()) if carried.sound else (belief, ("predict-failed",))

    def _updated(
        self, belief: Gaussian, records: Mapping[int, bytes], window: Window, place: int
    ) -> tuple[Gaussian, tuple[str, ...]]:
        """After all records of a step at once."""
        step = window.base_step + 1 + place
        taken = [
            one for source, record in records.items() for one in self._readings(source, record)
        ]
        if not taken:
            return belief, ()
        sensors = [reading.sensor for reading in taken]
        values, covs = [], []
        for _, state_noise, value, noise_cov in taken:
            if state_noise is not None:
                noise_cov = noise_cov + state_noise.state_noise_cov(belief, step)
            values.append(value)
            covs.append(noise_cov)
        after = update(
            belief,
            np.concatenate(values),
            partial(_measure, sensors, step),
            _block_diagonal(covs),
            self.points,
            residual=partial(_residual, sensors, [len(value) for value in values]),
        ).belief
        return (after, ()) if finite(after) else (belief, ("update-failed",))

    @cached_property
    def _readings(self) -> Callable[[int, bytes], list["_Reading"]]:
        """Each reading in a record. Kept: a window is filtered over and over."""
        return lru_cache(maxsize=_KEPT_RECORDS)(self._read)

    def _read(self, source: int, record: bytes) -> list["_Reading"]:
        sensor, codec = self.sensors[source], self.codecs[source]
        assert sensor is not None and codec is not None, "the frame codec knows no such source"
        state_noise = sensor if isinstance(sensor, StateNoise) else None
        readings: list[_Reading] = []
        for delivered in codec.decode(record):
            if np.isnan(delivered).all():
                continue
            value, noise_cov = sensor.interpret(delivered)
            if codec.rounding_cov is not None:
                noise_cov = noise_cov + codec.rounding_cov
            readings.append(_Reading(sensor, state_noise, value, noise_cov))
        return readings


class _Reading(NamedTuple):
    """One delivered reading: value (m,), noise covariance (m, m) with the rounding in it.

    `state_noise` is the sensor if it is noisier the larger the state is.
    """

    sensor: Sensor
    state_noise: StateNoise | None
    value: np.ndarray
    noise_cov: np.ndarray


def _measure(sensors: Sequence[Sensor], step: int, states: np.ndarray) -> np.ndarray:
    return np.concatenate([sensor.measure(states, step) for sensor in sensors], axis=-1)


def _residual(
    sensors: Sequence[Sensor], sizes: Sequence[int], values: np.ndarray, predicted: np.ndarray
) -> np.ndarray:
    parts: list[np.ndarray] = []
    start = 0
    for sensor, size in zip(sensors, sizes, strict=True):
        own = slice(start, start + size)
        parts.append(sensor.residual(values[..., own], predicted[..., own]))
        start += size
    return np.concatenate(parts, axis=-1)


def _block_diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    size = sum(len(block) for block in blocks)
    matrix = np.zeros((size, size))
    start = 0
    for block in blocks:
        stop = start + len(block)
        matrix[start:stop, start:stop] = block
        start = stop
    return matrix
