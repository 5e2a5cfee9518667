"""Sets over a sliding window: `window_filter` for plants whose noise has a bound.

The beliefs of the windows are ellipsoids, as centre and shape matrix; each holds the truth for
certain. The base is the set of the window's first step before its readings. A reading tells of the
noise that drives the plant on, so the step after a record is filtered with that record too
(`concord.features.sets.filters.joint_noise`). To take a record again is sound: sets count nothing.
"""

from functools import cached_property
from typing import cast

import numpy as np

from concord.features.sets.filters.ellipsoid import Ellipsoid
from concord.features.sets.filters.joint_noise import JointMotion, LinearReadings, joined
from concord.features.sets.set_membership import (
    BoundedModel,
    BoundedSensor,
    predict_sets,
    readings_of,
    take_readings,
)
from concord.features.sets.set_shapes import Ellipsoids, relative_size
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.labelled.window_filter import WindowFilter, Windows
from concord.nodes.rules.lane_rule import LocalStep
from concord.nodes.rules.local_filter import LocalFilters, where

# A checkpoint that makes a base smaller by less adds nothing; rounding alone does not decide.
_LEAST_GAIN = 1e-6


class WindowSets(WindowFilter):
    """`WindowFilter` that keeps ellipsoids. No sum of squared innovations says how records fit."""

    def opened(
        self, windows: Windows, control: np.ndarray | None, held: np.ndarray | None = None
    ) -> Windows:
        """With one step more; the oldest is carried into the base, with the records of it."""
        after = super().opened(windows, control, held)
        if windows.step < windows.first_step:
            # The base of a run that begins later is of the step before its first.
            if windows.first_step == 0:
                return after
            base = self._read(windows.base)
            return after._replace(base=self._moved(base, None, control, windows.first_step))
        if windows.first > 0:
            return after
        values = windows.values[:, None, 0]
        if held is not None:
            values = np.where(held[..., None, None], values, np.nan)
        oldest = Gaussian(windows.posteriors.mean[:, :, 0], windows.posteriors.cov[:, :, 0])
        step, width = windows.step_at(0), len(windows.controls)
        driven = control if width == 1 else windows.controls[1]
        kept, joint, _ = self._taken_all(oldest, values, step)
        return after._replace(base=self._moved(kept, joint, driven, step + 1))

    def fused(self, base: Gaussian, checkpoint: Gaussian) -> Gaussian:
        """Return the ellipsoids around what two hold; NaN where they have nothing in common."""
        own = self._read(base)
        both, meets = self._shape.meet(own, self._read(checkpoint))
        size = relative_size(self._shape.half_widths(both), self._shape.half_widths(own))
        found = where(size < 1.0 - _LEAST_GAIN, self._shape.bounds(both), base)
        return where(meets, found, Gaussian(np.full_like(found.mean, np.nan), found.cov))

    def _carried(
        self,
        windows: Windows,
        posteriors: Gaussian,
        place: int,
        runs: np.ndarray,
        lanes: np.ndarray,
        held: np.ndarray,
    ) -> tuple[Gaussian, np.ndarray]:
        sound = np.ones(len(runs), dtype=bool)
        if place == windows.first:
            return Gaussian(windows.base.mean[runs, lanes], windows.base.cov[runs, lanes]), sound
        before = runs, lanes, place - 1
        belief = Gaussian(posteriors.mean[before], posteriors.cov[before])
        step, control = windows.step_at(place), windows.controls[place]
        values = np.where(
            held[:, place - 1, :, None, None], windows.values[runs, place - 1], np.nan
        )
        kept, joint, _ = self._taken_all(belief, values, step - 1)
        driven = None if control is None else control[runs]
        return self._moved(kept, joint, driven, step, lanes=False), sound

    def _updated(
        self, windows: Windows, place: int, runs: np.ndarray, belief: Gaussian, held: np.ndarray
    ) -> tuple[Gaussian, np.ndarray, np.ndarray, np.ndarray]:
        """Ellipsoids (L, n) after the records of a place that lanes hold (L, N), all at once."""
        values = np.where(held[..., None, None], windows.values[runs, place], np.nan)
        kept, _, wrong = self._taken_all(belief, values, windows.step_at(place))
        nothing = np.zeros(len(runs))
        return self._shape.bounds(kept), ~wrong, nothing, nothing.astype(np.int64)

    def _taken_all(
        self, belief: Gaussian, values: np.ndarray, step: int
    ) -> tuple[Ellipsoid, JointMotion, np.ndarray]:
        """Ellipsoids (...) after readings (..., N, r, m) of all sources (`take_readings`)."""
        parts: list[LinearReadings] = []
        for index, sensor in self.sensors.groups:
            for node in np.arange(self.sensors.nodes)[index]:
                readings = values[..., node, :, :]
                parts.append(readings_of(cast(BoundedSensor, sensor), readings, step))
        motion = cast(BoundedModel, self.model).motion(step)
        return take_readings(self._shape, self._read(belief), joined(parts), motion)

    def _moved(
        self,
        sets: Ellipsoid,
        joint: JointMotion | None,
        control: np.ndarray | None,
        step: int,
        lanes: bool = True,
    ) -> Gaussian:
        """Ellipsoids (R, M, n) of the step before, or (L, n) without `lanes`, at `step`."""
        driven = control[:, None] if lanes and control is not None else control
        filters = LocalFilters(self.model, (), self.filter)
        now = LocalStep(filters, np.empty(0), driven, step)
        return self._shape.bounds(predict_sets(self._shape, sets, now, joint))

    def _read(self, belief: Gaussian) -> Ellipsoid:
        return self._shape.containing(belief)

    @cached_property
    def _shape(self) -> Ellipsoids:
        return Ellipsoids(len(cast(BoundedModel, self.model).motion(0)[0]))
