"""RunVerdict on the estimates of a network in one word, with its reason, as the page shows it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.frames.conditions import DOWN, STALE, conditions
from concord.dashboard.frames.expected import Expected
from concord.dashboard.frames.frame import StepFrame

STEPS = 20
"""Number of steps up to the shown one that a verdict is about."""
# Without a band: errors so many times larger or smaller than believed are remarkable.
_REMARKABLE = 1.5
# Of the steps: as many lie outside of the band by chance hardly ever.
_OUTSIDE = 0.5


class RunVerdict(NamedTuple):
    """A word, whether it is good news (None: neither), and a sentence that gives the reason."""

    word: str
    is_good: bool | None
    reason: str


def verdict(frames: Sequence[StepFrame], expected: Expected) -> RunVerdict:
    """Judge the newest of `frames`, which are at most `STEPS`; `expected` is about these frames."""
    stage, frame = frames[-1].stage, frames[-1]
    if frame.step < stage.score.first_step:
        return RunVerdict("SETTLING", None, f"steps count from step {stage.score.first_step} on")
    scored = [one.step >= stage.score.first_step for one in frames]
    judged = [one for one, counts in zip(frames, scored, strict=True) if counts]
    if not any(one.seen.any() for one in frames):
        since = f"no node has had a reading since step {frames[0].step} or before"
        return RunVerdict("NO READINGS", None, f"{since}; beliefs are predictions alone")
    if not np.isfinite(frame.scores.rmse):
        return RunVerdict("UNKNOWN", None, "the truth is not known, so no error is")
    if stage.set_valued:
        return _of_sets(frame)
    spread, believed = _rms(judged, "spread"), _believed(judged)
    consistency = np.array([one.scores.nees for one in judged])
    low, high = np.asarray(expected.nees_low)[scored], np.asarray(expected.nees_high)[scored]
    times = float(np.sqrt(np.nanmean(consistency) / len(stage.score.nees_states)))
    # The larger of two reasons is told.
    if spread > max(1.0, times) * believed > 0:
        apart = spread / believed
        return RunVerdict(
            "DISAGREEING",
            False,
            f"estimates differ by {rounded(apart, 2)} times what the nodes believe",
        )
    is_over, is_under = times > _REMARKABLE, times < 1 / _REMARKABLE
    usual = ""
    if np.isfinite(high).all():
        # The band decides, and a size of errors that speaks against its word is explained.
        usual = ", as in most other runs" if is_over or is_under else ""
        above, below = (consistency > high).mean(), (consistency < low).mean()
        is_over, is_under = above > _OUTSIDE, below > _OUTSIDE
        if is_over or is_under:
            usual = f", {'more' if is_over else 'less'} than in most other runs"
    reason = f"errors are {rounded(times, 2)} times what the nodes believe{usual}"
    reason += _beside_central(judged)
    if is_over:
        return RunVerdict(f"OVERCONFIDENT × {rounded(times, 2)}", False, reason)
    if is_under:
        return RunVerdict("CAUTIOUS", True, reason)
    return RunVerdict("CONSISTENT", True, reason)


def health(frame: StepFrame) -> str:
    """Return what is wrong with nodes and links in a step, beside the verdict; empty for nothing.

    The verdict is about errors and beliefs, which may be right in half a network.
    """
    words = conditions(frame)
    counts = (
        (int(frame.cut.sum()), "link{s} cut"),
        (words.count(DOWN), "node{s} down"),
        (words.count(STALE), "stale"),
    )
    return ", ".join(f"{count} {of.format(s='s' * (count > 1))}" for count, of in counts if count)


def _of_sets(frame: StepFrame) -> RunVerdict:
    """Judge sets: each must hold the truth."""
    outside = frame.alive & (frame.scores.error > frame.scores.width)
    if outside.any():
        return RunVerdict("OVERCONFIDENT", False, f"{outside.sum()} sets do not hold the truth")
    return RunVerdict("CONSISTENT", True, "no error is larger than its set")


def _rms(frames: Sequence[StepFrame], score: str) -> float:
    return float(np.sqrt(np.nanmean([getattr(one.scores, score) ** 2 for one in frames])))


def _believed(frames: Sequence[StepFrame]) -> float:
    """Return the root mean square of one standard deviation, over living nodes and steps."""
    return float(np.sqrt(np.mean([np.nanmean(one.scores.width[one.alive] ** 2) for one in frames])))


def _beside_central(frames: Sequence[StepFrame]) -> str:
    central = np.array([one.scores.central for one in frames])
    if not np.isfinite(central).all() or not central.any():
        return ""
    ratio = _rms(frames, "rmse") / _rms(frames, "central")
    return f", and {rounded(ratio, 2)} times those of a centralised filter"
