"""Tracks: beliefs of targets, each with the probability that its target exists, and an identity."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from concord.filters.gaussian import Gaussian
from concord.nodes.messages import TRACK_NUMBERS

IDENTITY = 3
"""Length of an identity: step, sensor and place in the scan of the detection that began it."""


class Tracks(NamedTuple):
    """T tracks in the order in which they began.

    Attributes:
        belief: mean (T, n), cov (T, n, n), given that the target exists; stacked where a target has
            several models of motion.
        existence: (T,), probability that it does.
        identity: (T, 3) integers. Equal records give equal identities at every node.
        confirmed: (T,), whether the existence has ever reached the threshold of confirmation.
    """

    belief: Gaussian
    existence: np.ndarray
    identity: np.ndarray
    confirmed: np.ndarray

    def chosen(self, which: np.ndarray) -> "Tracks":
        """Return the tracks of an index or a mask."""
        mean, cov = self.belief
        return Tracks(
            Gaussian(mean[which], cov[which]),
            self.existence[which],
            self.identity[which],
            self.confirmed[which],
        )


REPORTED_FROM = 0.5
"""Existence from which a confirmed track stands for a target."""


def reported(tracks: Tracks) -> Tracks:
    """Return the tracks that a user sees."""
    return tracks.chosen(tracks.confirmed & (tracks.existence >= REPORTED_FROM))


def number_of_targets(tracks: Tracks, undetected: float) -> Gaussian:
    """The number of targets: mean (1,), cov (1, 1).

    Each track stands for a target by its existence. The targets that no sensor has seen yet are
    Poisson with mean `undetected`.
    """
    there = tracks.existence
    variance = (there * (1 - there)).sum() + undetected
    return Gaussian(np.array([there.sum() + undetected]), np.array([[variance]]))


_SEEN = 4
"""A report tells the first states of a track, which are its place and its velocity."""


class TrackReport(NamedTuple):
    """Tracks as a user sees them, in rows: identity (T, 3), existence (T,), mean and std (T, 4)."""

    identity: np.ndarray
    existence: np.ndarray
    mean: np.ndarray
    std: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """All numbers (T, 12)."""
        return np.column_stack(self)


def report(tracks: Tracks, moments: Callable[[Gaussian], Gaussian]) -> TrackReport:
    """Return the tracks that stand for targets; `moments` gives mean and cov of their beliefs."""
    seen = reported(tracks)
    mean, cov = moments(seen.belief)
    std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    return TrackReport(seen.identity, seen.existence, mean[:, :_SEEN], std[:, :_SEEN])


def report_of(rows: ArrayLike) -> TrackReport:
    """Return the tracks of rows (T, 12)."""
    rows = np.asarray(rows, dtype=np.float64).reshape(-1, TRACK_NUMBERS)
    identity, existence, mean, std = np.split(
        rows, (IDENTITY, IDENTITY + 1, IDENTITY + 1 + _SEEN), axis=1
    )
    return TrackReport(identity.astype(int), existence[:, 0], mean, std)


def no_tracks(states: int) -> Tracks:
    """Return no track of a state of this size."""
    return Tracks(
        Gaussian(np.empty((0, states)), np.empty((0, states, states))),
        np.empty(0),
        np.empty((0, IDENTITY), dtype=int),
        np.empty(0, dtype=bool),
    )


def joined_tracks(older: Tracks, younger: Tracks) -> Tracks:
    """Return the tracks of both, the older ones first."""
    return Tracks(
        Gaussian(
            np.concatenate((older.belief.mean, younger.belief.mean)),
            np.concatenate((older.belief.cov, younger.belief.cov)),
        ),
        np.concatenate((older.existence, younger.existence)),
        np.concatenate((older.identity, younger.identity)),
        np.concatenate((older.confirmed, younger.confirmed)),
    )
