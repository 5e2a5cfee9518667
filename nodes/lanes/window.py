"""`nodes.rules.window_filter` at all nodes of all runs: beliefs behind each step of the last W.

A node's window is filtered again from the first step whose records have changed, all nodes and runs
at once; a reading that a node does not hold is NaN to it.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from filters.ukf import update
from nodes.lanes.filter import LocalFilters
from nodes.rules.local_filter import finite_lanes, predict_to_step, where
from nodes.rules.record_codec import RecordCodec


class Windows(NamedTuple):
    """Windows of all nodes: place W - 1 is this `step`, W - 2 the one before, ...

    Attributes:
        base: (R, N, ...), that everything older went into; at first the priors.
        posteriors: (R, N, W, ...) of the steps in the window; those before place `right` (R, N) are
            right.
        values: (R, W, N, m), what the records say; of each place, by source.
        controls: what drove into each place, (R, p); None where nothing did.
    """

    base: Gaussian
    posteriors: Gaussian
    right: np.ndarray
    values: np.ndarray
    controls: tuple[np.ndarray | None, ...]
    step: int

    @property
    def first(self) -> int:
        """The place of the window's first step."""
        return max(len(self.controls) - 1 - self.step, 0)

    @property
    def beliefs(self) -> Gaussian:
        """The posteriors of this step."""
        return _at(self.posteriors, len(self.controls) - 1)


@dataclass(frozen=True)
class WindowFilters:
    """The filter, and how each source writes its readings: one reading of `channels` entries."""

    filters: LocalFilters
    codecs: tuple[RecordCodec, ...]
    window_steps: int
    channels: int

    def start(self, prior: Gaussian) -> Windows:
        """Windows of no steps on priors (R, N, ...)."""
        runs, nodes, n = prior.mean.shape
        width = self.window_steps
        posteriors = Gaussian(
            np.zeros((runs, nodes, width, n)), np.zeros((runs, nodes, width, n, n))
        )
        return Windows(
            prior,
            posteriors,
            np.full((runs, nodes), width),
            np.full((runs, width, nodes, self.channels), np.nan),
            (None,) * width,
            -1,
        )

    def opened(self, windows: Windows, control: np.ndarray | None) -> Windows:
        """With one step more, and the oldest in the base where the window is full."""
        base = windows.base
        step = windows.step + 1
        if step >= self.window_steps:
            base = Gaussian(*(values.copy() for values in _at(windows.posteriors, 0)))
        empty = np.full_like(windows.values[:, :1], np.nan)
        return Windows(
            base,
            Gaussian(*(np.roll(values, -1, axis=2) for values in windows.posteriors)),
            windows.right - 1,
            np.concatenate((windows.values[:, 1:], empty), axis=1),
            (*windows.controls[1:], control),
            step,
        )

    def predicted(self, windows: Windows) -> tuple[Gaussian, np.ndarray]:
        """The posterior of the step before at this one, and where that went well (R, N)."""
        if windows.step == 0:
            return windows.base, np.ones(windows.right.shape, dtype=bool)
        place = self.window_steps - 2
        alone = place < windows.first
        belief = windows.base if alone else _at(windows.posteriors, place)
        return self.filters.predict(belief, windows.controls[-1], windows.step)

    def filtered(self, windows: Windows, held: np.ndarray) -> tuple[Windows, dict[str, np.ndarray]]:
        """With the posteriors of all steps, of what nodes hold (R, N, W, N); what went wrong."""
        posteriors = Gaussian(*(values.copy() for values in windows.posteriors))
        begin = np.maximum(windows.right, windows.first)
        failures = {
            name: np.zeros(begin.shape, dtype=np.int64)
            for name in ("predict-failed", "update-failed")
        }
        for place in range(int(begin.min()), self.window_steps):
            runs, nodes = np.nonzero(begin <= place)
            before = windows.base if place == windows.first else _at(posteriors, place - 1)
            belief = Gaussian(*(values[runs, nodes] for values in before))
            belief, moved = self._carried(windows, place, runs, belief)
            there = held[runs, nodes, place]
            belief, updated = self._updated(windows, place, runs, belief, there)
            for values, found in zip(posteriors, belief, strict=True):
                values[runs, nodes, place] = found
            failures["predict-failed"][runs, nodes] += ~moved
            failures["update-failed"][runs, nodes] += ~updated
        right = np.full_like(windows.right, self.window_steps)
        return windows._replace(posteriors=posteriors, right=right), failures

    def _carried(
        self, windows: Windows, place: int, runs: np.ndarray, belief: Gaussian
    ) -> tuple[Gaussian, np.ndarray]:
        step, control = self._step_at(windows, place), windows.controls[place]
        if step == 0:
            return belief, np.ones(len(runs), dtype=bool)
        driven = None if control is None else control[runs]
        moved, sound = predict_to_step(
            belief, driven, step, self.filters.model, self.filters.points
        )
        return where(sound, moved, belief), sound

    def _updated(
        self,
        windows: Windows,
        place: int,
        runs: np.ndarray,
        belief: Gaussian,
        there: np.ndarray,
    ) -> tuple[Gaussian, np.ndarray]:
        """Beliefs (L, n) after all records of the place at once that are `there` (L, N)."""
        most = int(there.sum(axis=1).max(initial=0))
        if most == 0:
            return belief, np.ones(len(runs), dtype=bool)
        # Those that are held come first, sources ascending; the rest is filled up with NaN.
        sources = np.argsort(~there, axis=1, kind="stable")[:, :most]
        values = windows.values[runs[:, None], place, sources]
        values = np.where(np.take_along_axis(there, sources, axis=1)[..., None], values, np.nan)
        flat = (len(runs), most * self.channels)
        after = update(
            belief,
            values.reshape(flat),
            partial(self._measure, sources, self._step_at(windows, place)),
            _block_diagonal(self._noise_cov[sources]),
            self.filters.points,
            residual=self._residual,
        ).belief
        sound = finite_lanes(after)
        return where(sound, after, belief), sound

    def _measure(self, sources: np.ndarray, step: int, states: np.ndarray) -> np.ndarray:
        """Return the readings of these sources (L, K) at states (..., L, n): (..., L, K m)."""
        everywhere = np.broadcast_to(
            states[..., None, :], (*states.shape[:-1], len(self.codecs), states.shape[-1])
        )
        read = self.filters.groups[0].sensor.measure(everywhere, step)
        chosen = np.take_along_axis(
            read, sources.reshape((1,) * (read.ndim - 3) + (*sources.shape, 1)), axis=-2
        )
        return chosen.reshape(*chosen.shape[:-2], -1)

    def _residual(self, values: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        apart = [one.reshape(*one.shape[:-1], -1, self.channels) for one in (values, predicted)]
        found = self.filters.groups[0].sensor.residual(*apart)
        return found.reshape(*found.shape[:-2], -1)

    def _step_at(self, windows: Windows, place: int) -> int:
        return windows.step - (self.window_steps - 1 - place)

    @cached_property
    def _noise_cov(self) -> np.ndarray:
        """Of a reading of each source, (N, m, m), with the rounding in it."""
        nothing = np.full((len(self.codecs), self.channels), np.nan)
        noise_cov = self.filters.groups[0].sensor.interpret(nothing)[1]
        found = np.array(np.broadcast_to(noise_cov, (*nothing.shape, self.channels)))
        for source, codec in enumerate(self.codecs):
            if codec.rounding_cov is not None:
                found[source, : codec.channels, : codec.channels] += codec.rounding_cov
        return found


def _at(posteriors: Gaussian, place: int) -> Gaussian:
    return Gaussian(posteriors.mean[:, :, place], posteriors.cov[:, :, place])


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """Matrices (L, K m, K m) of blocks (L, K, m, m)."""
    lanes, count, size = blocks.shape[:3]
    matrix = np.zeros((lanes, count, size, count, size))
    each = np.arange(count)
    matrix[:, each, :, each] = blocks.swapaxes(0, 1)
    return matrix.reshape(lanes, count * size, count * size)
