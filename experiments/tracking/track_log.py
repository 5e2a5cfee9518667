"""The tracks of one tracker over a run beside the truth, and the scores of the run."""

import math

import msgspec
import numpy as np

from concord.filters.tracking.scores import (
    NOT_ASSIGNED,
    Gospa,
    gospa,
    identity_switches,
    ospa,
)
from concord.filters.tracking.tracks import Tracks, reported

CUTOFF_M, ORDER = 50.0, 2
PLACES = slice(0, None, 2)  # of a state [x, vx, y, vy]


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


class TrackLog:
    """Steps of one tracker, scored as they come.

    `reported` are the steps, each with the tracks that the tracker reported.
    """

    def __init__(self) -> None:
        self.reported: list[tuple[int, Tracks]] = []
        self._scored: list[Gospa] = []
        self._ospa_m: list[float] = []
        self._assigned: list[dict[int, object]] = []

    def add(self, step: int, states: np.ndarray, tracks: Tracks) -> None:
        """Score the tracks of a step beside the true states (K, 4), NaN where there is none."""
        there = np.flatnonzero(np.isfinite(states).all(axis=-1))
        seen = reported(tracks)
        self.reported.append((step, seen))
        truth, estimates = states[there][:, PLACES], seen.belief.mean[:, PLACES]
        found = gospa(truth, estimates, CUTOFF_M, ORDER)
        identities = [tuple(identity) for identity in seen.identity.tolist()]
        self._assigned.append(
            {
                int(target): None if place == NOT_ASSIGNED else identities[place]
                for target, place in zip(there, found.assigned, strict=True)
            }
        )
        self._scored.append(found)
        self._ospa_m.append(ospa(truth, estimates, CUTOFF_M, ORDER))

    def scores(self) -> TrackingScores:
        """Return the scores of all steps."""
        distance, localisation, missed, false, assigned = zip(*self._scored, strict=True)
        tracked = sum(int((one != NOT_ASSIGNED).sum()) for one in assigned)
        numbers = np.array(missed) - np.array(false)
        return TrackingScores(
            gospa_m=float(np.mean(distance)),
            localisation_m=math.sqrt(sum(localisation) / tracked) if tracked else math.nan,
            missed=float(np.mean(missed)),
            false=float(np.mean(false)),
            ospa_m=float(np.mean(self._ospa_m)),
            cardinality_error=float(np.abs(numbers).mean()),
            identity_switches=identity_switches(self._assigned),
            steps_to_confirm=self._steps_to_confirm(),
        )

    def _steps_to_confirm(self) -> float:
        first: dict[int, int] = {}
        waited: dict[int, int] = {}
        for step, targets in enumerate(self._assigned):
            for target, identity in targets.items():
                first.setdefault(target, step)
                if identity is not None:
                    waited.setdefault(target, step - first[target])
        return float(np.mean(list(waited.values()))) if waited else math.nan
