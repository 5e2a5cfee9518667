"""The tracks of one tracker over a run beside the truth, and the scores of the run."""

import math
from functools import cached_property

import msgspec
import numpy as np

from concord.features.several_targets.scanned_swarm import PLACES
from concord.features.several_targets.tracking.scores import (
    CUTOFF_M,
    NOT_ASSIGNED,
    ORDER,
    Gospa,
    gospa,
    identity_switches,
    ospa,
)
from concord.features.several_targets.tracking.tracks import TrackReport


class TrackingScores(msgspec.Struct, frozen=True):
    """Scores of one run, means over its steps unless they say otherwise; cutoff 50 m, order 2.

    NaN where a run has nothing to score: no target, or none that was ever tracked.
    """

    gospa_m: float
    localisation_m: float  # root mean square distance of tracked targets
    missed: float  # targets without a track
    false: float  # tracks without a target
    ospa_m: float
    cardinality_error: float  # size of the difference in number
    identity_switches: float  # in the whole run
    steps_to_confirm: float  # from the first step of a target to its first track


def there(states: np.ndarray) -> np.ndarray:
    """The places (K',) of the targets that are there in states (K, 4)."""
    return np.flatnonzero(np.isfinite(states).all(axis=-1))


def scored(states: np.ndarray, tracks: TrackReport) -> Gospa:
    """GOSPA of tracks beside the true states (K, 4), NaN where there is no target."""
    truth, estimates = states[there(states)][:, PLACES], tracks.mean[:, PLACES]
    return gospa(truth, estimates, CUTOFF_M, ORDER)


class TrackLog:
    """Tracks of one tracker step by step, and the true states (K, 4) of the same steps."""

    def __init__(self) -> None:
        self.steps: list[int] = []
        self.reports: list[TrackReport] = []
        self._truth: list[np.ndarray] = []

    def add(self, step: int, states: np.ndarray, tracks: TrackReport) -> None:
        """Keep the tracks of a step beside the true states (K, 4)."""
        self.steps.append(step)
        self.reports.append(tracks)
        self._truth.append(states)

    @cached_property
    def scored(self) -> list[Gospa]:
        """GOSPA of each step."""
        return [scored(*pair) for pair in zip(self._truth, self.reports, strict=True)]

    def distances(self, steps: int) -> np.ndarray:
        """GOSPA in m (steps,), NaN in steps that are not kept."""
        found = np.full(steps, np.nan)
        found[self.steps] = [one.distance for one in self.scored]
        return found

    def scores(self) -> TrackingScores:
        """Return the scores of all steps; NaN without any."""
        if not self.steps:
            return TrackingScores(*(math.nan,) * len(TrackingScores.__struct_fields__))
        distance, localisation, missed, false, assigned = zip(*self.scored, strict=True)
        tracked = sum(int((one != NOT_ASSIGNED).sum()) for one in assigned)
        numbers = np.array(missed) - np.array(false)
        identities = [self._assigned(place) for place in range(len(self.steps))]
        return TrackingScores(
            gospa_m=float(np.mean(distance)),
            localisation_m=math.sqrt(sum(localisation) / tracked) if tracked else math.nan,
            missed=float(np.mean(missed)),
            false=float(np.mean(false)),
            ospa_m=float(np.mean(self._ospa_m())),
            cardinality_error=float(np.abs(numbers).mean()),
            identity_switches=identity_switches(identities),
            steps_to_confirm=_steps_to_confirm(self.steps, identities),
        )

    def _ospa_m(self) -> list[float]:
        return [
            ospa(states[there(states)][:, PLACES], tracks.mean[:, PLACES], CUTOFF_M, ORDER)
            for states, tracks in zip(self._truth, self.reports, strict=True)
        ]

    def _assigned(self, place: int) -> dict[int, object]:
        """The identity of the track of each target that is there; None where it has none."""
        identities = [tuple(identity) for identity in self.reports[place].identity.tolist()]
        targets = there(self._truth[place])
        return {
            int(target): None if track == NOT_ASSIGNED else identities[track]
            for target, track in zip(targets, self.scored[place].assigned, strict=True)
        }


def _steps_to_confirm(steps: list[int], identities: list[dict[int, object]]) -> float:
    first: dict[int, int] = {}
    waited: dict[int, int] = {}
    for step, targets in zip(steps, identities, strict=True):
        for target, identity in targets.items():
            first.setdefault(target, step)
            if identity is not None:
                waited.setdefault(target, step - first[target])
    return float(np.mean(list(waited.values()))) if waited else math.nan
