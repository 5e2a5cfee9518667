"""Fusion of the tracks of two nodes: association, covariance intersection, existence and labels.

A track says when a sensor last looked at its place. Of two tracks of one target, the one that was
looked at later says whether the target exists. So a node that cannot see a target votes for
nothing, and the end of a target reaches nodes that cannot see it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.features.several_targets.association.best_hypotheses import MISSED, best_hypothesis
from concord.features.several_targets.association.weights import Weights
from concord.features.several_targets.tracking.tracker import Scan, TrackerSettings, track
from concord.features.several_targets.tracking.tracks import REPORTED_FROM, Tracks, joined_tracks
from concord.filters.fusion.determinant_intersection import determinant_intersection
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import inverse_spd, multiply

LOOKS_FROM = 0.1
"""Detection probability from which a scan is a look at a place."""
ENDED_STEPS = 8
"""Steps in which nodes tell of the end of a track."""
GATE = 18.47
"""Greatest squared Mahalanobis distance of two tracks of one target: that of 0.999 for 4 states."""
_LEAST = 1e-6
"""Existence is taken to lie so far from 0 and 1 at least, as its odds are averaged."""


class LookedAt(NamedTuple):
    """Tracks, and the step (T,) in which a sensor last looked at the place of each."""

    tracks: Tracks
    looked: np.ndarray

    def chosen(self, which: np.ndarray) -> "LookedAt":
        """Return those of an index or a mask."""
        return LookedAt(self.tracks.chosen(which), self.looked[which])


def tracked_on(
    before: LookedAt, scans: Sequence[Scan], settings: TrackerSettings, step: int
) -> tuple[LookedAt, int]:
    """The tracks one step later, and how many clusters were beyond the bound of the exact sum.

    A confirmed track that these scans end stays for some steps with existence 0, so that nodes that
    cannot see its place hear of the end.
    """
    alive = before.tracks.existence >= settings.end_below
    tracks, approximated = track(before.tracks.chosen(alive), scans, settings, step)
    labels = tracks.identity.tolist()
    last = {
        tuple(label): looked
        for label, looked in zip(before.tracks.identity.tolist(), before.looked, strict=True)
    }
    known = LookedAt(tracks, np.array([last.get(tuple(one), step) for one in labels], dtype=int))
    known = known._replace(looked=_looks(known, scans, step))
    gone = [label not in labels for label in before.tracks.identity.tolist()]
    ended = np.array(gone, dtype=bool) & before.tracks.confirmed
    looked = np.where(alive, _looks(before, scans, step), before.looked)
    ended &= np.where(alive, looked == step, looked > step - ENDED_STEPS)
    over = before.tracks._replace(existence=np.zeros(len(gone)))
    return _joined(known, LookedAt(over, looked).chosen(ended)), approximated


def _looks(known: LookedAt, scans: Sequence[Scan], step: int) -> np.ndarray:
    """The steps (T,) of the last looks, given the scans of a step."""
    looked, mean = known.looked, known.tracks.belief.mean
    for scan in scans:
        looked = np.where(scan.sensor.detection_probability(mean) >= LOOKS_FROM, step, looked)
    return looked


def _joined(one: LookedAt, more: LookedAt) -> LookedAt:
    """Both, in the order of their labels."""
    tracks = joined_tracks(one.tracks, more.tracks)
    looked = np.concatenate((one.looked, more.looked))
    return LookedAt(tracks, looked).chosen(np.lexsort(tracks.identity.T[::-1]))


def fused_tracks(own: LookedAt, heard: LookedAt) -> LookedAt:
    """The own tracks after those of a neighbour, in the order of their labels.

    Tracks of one target are found by labels, and else by an assignment within the gate. Their
    states are fused by covariance intersection. They take the older label, unless another own track
    has it. Tracks that only the neighbour has are taken over if they stand for a target.
    """
    if not len(heard.looked):
        return own
    distance, same = _distances(own.tracks, heard.tracks)
    chosen = _assigned(np.where(same, 0.0, distance))
    mine = np.flatnonzero(chosen != MISSED)
    theirs = chosen[mine]
    pairs = _paired(own.chosen(mine), heard.chosen(theirs), distance[mine, theirs])
    labelled = _with_labels(pairs.tracks, heard.tracks.chosen(theirs), own.tracks)
    left = own.chosen(chosen == MISSED)
    known = np.asarray(same.any(axis=0))
    known[theirs] = True
    new = heard.chosen(~known & (heard.tracks.existence >= REPORTED_FROM))
    return _joined(_joined(left, pairs._replace(tracks=labelled)), new)


def _distances(own: Tracks, heard: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Squared Mahalanobis distances (T, U) as if errors were independent, and equal labels."""
    away = own.belief.mean[:, None] - heard.belief.mean
    both = own.belief.cov[:, None] + heard.belief.cov
    same = (own.identity[:, None] == heard.identity).all(axis=-1)
    return np.vecdot(away, multiply(inverse_spd(both), away)), same


def _assigned(distance: np.ndarray) -> np.ndarray:
    """The track of the neighbour (T,) that each own one is paired with; -1 for none."""
    hit = np.where(distance <= GATE, np.exp(-0.5 * distance), 0.0)
    return best_hypothesis(Weights(np.full(len(hit), np.exp(-0.5 * GATE)), hit))


def _paired(own: LookedAt, heard: LookedAt, distance: np.ndarray) -> LookedAt:
    """Pairs of tracks of one target as one track each, with the own label."""
    ours, theirs = own.tracks, heard.tracks
    newer, older = heard.looked > own.looked, heard.looked < own.looked
    belief = determinant_intersection(ours.belief, theirs.belief)
    # Equal labels far apart: one of both was lost, and the last look decides.
    apart, failed = distance > GATE, np.isnan(belief.mean).any(axis=-1)
    belief = _where(apart & newer, theirs.belief, _where(apart | failed, ours.belief, belief))
    # A track that is confirmed knows more than one that has just begun.
    newer |= ~older & theirs.confirmed & ~ours.confirmed
    older |= ~newer & ours.confirmed & ~theirs.confirmed
    odds = (_log_odds(ours.existence) + _log_odds(theirs.existence)) / 2
    equal = ours.existence == theirs.existence
    existence = np.where(equal, ours.existence, 1 / (1 + np.exp(-odds)))
    existence = np.where(newer, theirs.existence, np.where(older, ours.existence, existence))
    fused = Tracks(belief, existence, ours.identity, ours.confirmed | theirs.confirmed)
    return LookedAt(fused, np.maximum(own.looked, heard.looked))


def _with_labels(fused: Tracks, heard: Tracks, own: Tracks) -> Tracks:
    """The pairs with the older label of both, where no other own track has it."""
    used = {tuple(label) for label in own.identity.tolist()}
    labels = fused.identity.copy()
    for place, theirs in enumerate(heard.identity.tolist()):
        if theirs < labels[place].tolist() and tuple(theirs) not in used:
            used.add(tuple(theirs))
            labels[place] = theirs
    return fused._replace(identity=labels)


def _log_odds(probability: np.ndarray) -> np.ndarray:
    kept = np.clip(probability, _LEAST, 1 - _LEAST)
    return np.log(kept / (1 - kept))


def _where(chosen: np.ndarray, one: Gaussian, other: Gaussian) -> Gaussian:
    return Gaussian(
        np.where(chosen[:, None], one.mean, other.mean),
        np.where(chosen[:, None, None], one.cov, other.cov),
    )
