"""A filter over a sliding window: records may come late and in any order, and each counts once.

Lanes are nodes of runs, (R, M); a node by itself is one lane. A window is filtered again from
the first step whose records have changed; a reading that a lane does not hold is NaN to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from concord.filters.filter import Filter
from concord.filters.fusion.determinant_intersection import determinant_intersection
from concord.filters.gaussian import Gaussian
from concord.filters.turns import angles_of, beside
from concord.filters.update import Update
from concord.nodes.rules.all_sensors import AllSensors, SourceSensors
from concord.nodes.rules.labelled.kept_steps import KeptSteps
from concord.nodes.rules.labelled.record_codec import RecordForm
from concord.nodes.rules.lane_rule import Failures
from concord.nodes.rules.local_filter import Carried, Model, finite_lanes, predict_to_step, where


class Windows(NamedTuple):
    """Windows of lanes: place W - 1 is this `step`, W - 2 the one before, ...

    Attributes:
        base: (R, M, ...), that everything older went into; at first the priors.
        posteriors: (R, M, W, ...) of the steps in the window; those before place `right` (R, M) are
            right.
        surprise, entries: (R, M, W), of all records of a step: normalised innovation squared, added
            up, and how many numbers they have. With a matched filter the first is chi-square with
            as many degrees of freedom as the second says. With `WindowFilter.silence_fits` the
            second also counts the numbers that sources may have withheld.
        values, noise_covs: (R, W, N, r, m), (R, W, N, r, m, m) of what the records of a run say; of
            each place, by source.
        controls: what drove into each place, (R, p); None where nothing did.
        first_step: of the run. Its base is the belief of the step before; the prior of a run that
            begins at 0 is the belief at step 0 before any reading, and no prediction leads there.
    """

    base: Gaussian
    posteriors: Gaussian
    right: np.ndarray
    surprise: np.ndarray
    entries: np.ndarray
    values: np.ndarray
    noise_covs: np.ndarray
    controls: tuple[np.ndarray | None, ...]
    step: int
    first_step: int

    @property
    def first(self) -> int:
        """The place of the window's first step."""
        return max(len(self.controls) - 1 - (self.step - self.first_step), 0)

    @property
    def beliefs(self) -> Gaussian:
        """The newest posteriors; those of the step before until the window is filtered."""
        if self.step < self.first_step:
            return self.base
        return Gaussian(self.posteriors.mean[:, :, -1], self.posteriors.cov[:, :, -1])

    def step_at(self, place: int) -> int:
        """Return the step of a place."""
        return self.step - (len(self.controls) - 1 - place)


class FilteredPlace(NamedTuple):
    """A place of windows of lanes (L,): posteriors, what went well, and what records said."""

    belief: Gaussian
    moved: np.ndarray
    updated: np.ndarray
    surprise: np.ndarray
    entries: np.ndarray


@dataclass(frozen=True)
class WindowFilter:
    """Knowledge common to all nodes: the plant, and the sensor and records of each node.

    A record that cannot be used is counted; its step keeps the prediction. `silence_fits`: sources
    withhold what fits the prediction, so that no record counts as one of no surprise. `late_steps`
    (N,): from a reading of a node to its delivery. `kept` is shared by the nodes of one process,
    whose windows are often equal.
    """

    model: Model
    filter: Filter
    sensors: AllSensors
    codecs: Sequence[RecordForm | None]
    silence_fits: bool = False
    late_steps: tuple[int, ...] = ()
    kept: KeptSteps[FilteredPlace] | None = None

    def start(self, prior: Gaussian, first_step: int, width: int) -> Windows:
        """Windows of no steps on priors (R, M, n), for at most `width` steps."""
        runs, lanes, n = prior.mean.shape
        numbers = self.sensors.size
        shape = (runs, width, self.sensors.nodes, self.sensors.delivered[0], numbers)
        return Windows(
            prior,
            Gaussian(np.zeros((runs, lanes, width, n)), np.zeros((runs, lanes, width, n, n))),
            np.full((runs, lanes), width),
            np.zeros((runs, lanes, width)),
            np.zeros((runs, lanes, width), dtype=np.int64),
            np.full(shape, np.nan),
            np.zeros((*shape, numbers)),
            (None,) * width,
            first_step - 1,
            first_step,
        )

    def forgotten(self, windows: Windows, prior: Gaussian) -> Windows:
        """The same steps without records, on other bases (R, M, n)."""
        values, right = np.full_like(windows.values, np.nan), np.zeros_like(windows.right)
        return self.filtered(windows._replace(base=prior, values=values, right=right))[0]

    def opened(
        self, windows: Windows, control: np.ndarray | None, held: np.ndarray | None = None
    ) -> Windows:
        """With one step more; the oldest, of which lanes hold `held` (R, M, N), in the base."""
        base, (mean, cov), belief = windows.base, windows.posteriors, windows.beliefs
        if windows.step >= windows.first_step and windows.first == 0:
            base = Gaussian(mean[:, :, 0].copy(), cov[:, :, 0].copy())
        return windows._replace(
            base=base,
            posteriors=Gaussian(
                one_place_on(mean, 2, belief.mean), one_place_on(cov, 2, belief.cov)
            ),
            right=windows.right - 1,
            surprise=one_place_on(windows.surprise, 2),
            entries=one_place_on(windows.entries, 2),
            values=one_place_on(windows.values, 1, np.nan),
            noise_covs=one_place_on(windows.noise_covs, 1),
            controls=(*windows.controls[1:], control),
            step=windows.step + 1,
        )

    def with_readings(self, windows: Windows, places: np.ndarray, delivered: np.ndarray) -> Windows:
        """With what new records say at places (P,): readings (R, P, N, r, d), NaN elsewhere."""
        new, covs = self.sensors.interpret(delivered)
        covs += self._rounding_covs[:, None]
        taken = (~np.isnan(delivered)).any(axis=(-1, -2), keepdims=True)
        values, noise_covs = windows.values.copy(), windows.noise_covs.copy()
        values[:, places] = np.where(taken, new, values[:, places])
        noise_covs[:, places] = np.where(np.expand_dims(taken, -1), covs, noise_covs[:, places])
        return windows._replace(values=values, noise_covs=noise_covs)

    def fused(self, base: Gaussian, checkpoint: Gaussian) -> Gaussian:
        """Return bases (..., n) fused with checkpoints; bit for bit those that gain nothing."""
        return determinant_intersection(base, checkpoint)

    def predicted(self, windows: Windows, control: np.ndarray | None) -> Carried:
        """The newest posteriors (R, M) one step later, and where that went well."""
        belief, step = windows.beliefs, windows.step + 1
        if step == 0:
            return Carried(belief, np.ones(windows.right.shape, dtype=bool))
        driven = None if control is None else control[:, None]
        moved, sound = predict_to_step(belief, driven, step, self.model, self.filter)
        return Carried(where(sound, moved, belief), sound)

    def filtered(
        self, windows: Windows, held: np.ndarray | None = None
    ) -> tuple[Windows, Failures]:
        """With the posteriors of all steps, of what lanes hold (R, M, W, N); what went wrong.

        Without `held` all lanes hold all records of their run.
        """
        if held is None:
            held = np.ones((*windows.right.shape, *windows.values.shape[1:3]), dtype=bool)
        posteriors = Gaussian(*(values.copy() for values in windows.posteriors))
        surprise, entries = windows.surprise.copy(), windows.entries.copy()
        begin = np.maximum(windows.right, windows.first)
        names = "predict-failed", "update-failed"
        failures = {name: np.zeros(begin.shape, dtype=np.int64) for name in names}
        for place in range(int(begin.min()), len(windows.controls)):
            runs, lanes = np.nonzero(begin <= place)
            found = _filtered_place(
                self, windows, posteriors, place, runs, lanes, held[runs, lanes]
            )
            at = runs, lanes, place
            surprise[at], entries[at] = found.surprise, found.entries
            posteriors.mean[at], posteriors.cov[at] = found.belief
            for name, sound in zip(failures, (found.moved, found.updated), strict=True):
                if not sound.all():
                    failures[name][runs, lanes] += ~sound
        right = np.full_like(windows.right, len(windows.controls))
        filtered = windows._replace(
            posteriors=posteriors, right=right, surprise=surprise, entries=entries
        )
        return filtered, failures

    def _carried(
        self,
        windows: Windows,
        posteriors: Gaussian,
        place: int,
        runs: np.ndarray,
        lanes: np.ndarray,
        held: np.ndarray,
    ) -> tuple[Gaussian, np.ndarray]:
        """Beliefs (L, n) at a place by those of the one before, and which could be carried."""
        if place == windows.first:
            belief = Gaussian(windows.base.mean[runs, lanes], windows.base.cov[runs, lanes])
        else:
            before = runs, lanes, place - 1
            belief = Gaussian(posteriors.mean[before], posteriors.cov[before])
        step, control = windows.step_at(place), windows.controls[place]
        if step == 0:
            return belief, np.ones(len(runs), dtype=bool)
        driven = None if control is None else control[runs]
        moved, sound = predict_to_step(belief, driven, step, self.model, self.filter)
        return where(sound, moved, belief), sound

    def _updated(
        self, windows: Windows, place: int, runs: np.ndarray, belief: Gaussian, held: np.ndarray
    ) -> tuple[Gaussian, np.ndarray, np.ndarray, np.ndarray]:
        """Beliefs (L, n) after the records of a place that lanes hold (L, N), one by one.

        Returns also which went well, their surprise and the number of their entries, (L,) each.
        Sources ascend, as in the centralised filter (`concord.scenarios.baselines`).
        """
        step, numbers = windows.step_at(place), self.sensors.size
        flat = windows.values[:, place].reshape(len(windows.values), -1, numbers)
        noise_covs = windows.noise_covs[:, place].reshape(*flat.shape, numbers)
        several = self.sensors.delivered[0]
        read = np.asarray((~np.isnan(flat)).any(axis=-1))
        there = np.repeat(held, several, axis=1) & read[runs]
        # Those that are held come first; the rest is filled up with NaN.
        chosen = np.argsort(~there, axis=1, kind="stable")
        lanes, sound = np.arange(len(runs)), np.ones(len(runs), dtype=bool)
        surprise, entries = np.zeros(len(runs)), np.zeros(len(runs), dtype=np.int64)
        for turn in range(int(there.sum(axis=1).max(initial=0))):
            which = chosen[:, turn]
            values = np.where(there[lanes, which, None], flat[runs, which], np.nan)
            update = self._taken(belief, values, noise_covs[runs, which], which // several, step)
            is_finite = finite_lanes(update.belief)
            belief, sound = where(is_finite, update.belief, belief), sound & is_finite
            surprise += np.where(is_finite, update.normalised_innovation_squared, 0)
            entries += is_finite * np.count_nonzero(~np.isnan(values), axis=-1)
        if self.silence_fits:
            entries = np.maximum(entries, self._numbers_per_step)
        return belief, sound, surprise, entries

    def _taken(
        self,
        belief: Gaussian,
        values: np.ndarray,
        noise_covs: np.ndarray,
        sources: np.ndarray,
        step: int,
    ) -> Update:
        """Beliefs (L, n) after one reading each (L, m) of these sources (L,), and what it said."""
        sensors = self.sensors.of(sources[:, None])
        if (state_noise := sensors.state_noise(belief, step)) is not None:
            noise_covs = noise_covs + state_noise[:, 0]
        return self.filter.update(
            belief,
            values,
            lambda states: sensors.measure(states, step)[..., 0, :],
            noise_covs,
            residual=partial(_residual, sensors),
        )

    @cached_property
    def _numbers_per_step(self) -> int:
        """How many numbers the records of all sources have at most."""
        return sum(codec.readings * codec.channels for codec in self.codecs if codec is not None)

    @cached_property
    def _rounding_covs(self) -> np.ndarray:
        """Covariances (N, m, m) that rounding adds to the noise of a reading of each source."""
        found = np.zeros((self.sensors.nodes, self.sensors.size, self.sensors.size))
        for source, codec in enumerate(self.codecs):
            if codec is not None and codec.rounding_cov is not None:
                found[source, : codec.channels, : codec.channels] = codec.rounding_cov
        return found


def _filtered_place(
    filter: WindowFilter,
    windows: Windows,
    posteriors: Gaussian,
    place: int,
    runs: np.ndarray,
    lanes: np.ndarray,
    held: np.ndarray,
) -> FilteredPlace:
    """A place by those before it, of what lanes hold (L, W, N)."""

    def compute() -> FilteredPlace:
        belief, moved = filter._carried(windows, posteriors, place, runs, lanes, held)
        belief, updated, *told = filter._updated(windows, place, runs, belief, held[:, place])
        return FilteredPlace(belief, moved, updated, *told)

    if filter.kept is None or len(runs) > 1:
        return compute()
    is_first, control = place == windows.first, windows.controls[place]
    before = windows.base if is_first else Gaussian(*(v[:, :, place - 1] for v in posteriors))
    near = slice(place if is_first else place - 1, place + 1)
    numbers = (*before, windows.values[:, near], windows.noise_covs[:, near], held[:, near])
    key = (is_first, None if control is None else control.tobytes())
    step = windows.step_at(place)
    return filter.kept.of(step, (*key, *(one.tobytes() for one in numbers)), compute)


def checkpoint_of(filter: WindowFilter, base: Gaussian) -> Gaussian:
    """Return bases (..., n) as they are sent, with angles within half a turn of 0."""
    return Gaussian(beside(base.mean, 0.0, angles_of(filter.model)), base.cov)


def fuse_base(
    filter: WindowFilter, base: Gaussian, checkpoint: Gaussian
) -> tuple[Gaussian, np.ndarray, np.ndarray]:
    """Return bases (..., n) fused with checkpoints, where (...) it worked, and where it gained."""
    mean = beside(checkpoint.mean, base.mean, angles_of(filter.model))
    fused = filter.fused(base, Gaussian(mean, checkpoint.cov))
    sound = finite_lanes(fused)
    same = (fused.mean == base.mean).all(-1) & (fused.cov == base.cov).all((-1, -2))
    return fused, sound, sound & ~same


def steps_late(filter: WindowFilter, node: int) -> int:
    """Return the steps from a reading of a node to its delivery."""
    return filter.late_steps[node] if filter.late_steps else 0


def one_lane(belief: Gaussian) -> Gaussian:
    """A belief (n,) as that of one lane of one run, (1, 1, n)."""
    return Gaussian(belief.mean[None, None], belief.cov[None, None])


def one_place_on(values: np.ndarray, axis: int, newest: np.ndarray | float = 0) -> np.ndarray:
    """The values of places on an axis a step later: the oldest is forgotten."""
    moved = np.empty_like(values)
    now = np.moveaxis(moved, axis, 0)
    now[:-1] = np.moveaxis(values, axis, 0)[1:]
    now[-1] = newest
    return moved


def _residual(sensors: SourceSensors, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return sensors.residual(one[..., None, :], other[..., None, :])[..., 0, :]
