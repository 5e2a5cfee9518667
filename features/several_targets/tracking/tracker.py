"""A tracker of several targets: predict, associate each scan, begin and end tracks.

Each track has the probability that its target exists (joint integrated probabilistic data
association, Musicki and Evans 2004, IEEE Trans. AES 40(3)). A sensor that cannot see a track has
detection probability 0 there, and leaves its existence as it is. Functions on values, without
memory: equal tracks and equal detections give equal tracks, bit for bit. The detections of a scan
are put in the order of their values first, so the order of their arrival has no effect.

A target may change between models of motion: the belief of a track is then a stacked one
(`filters/interacting_models.py`), and that of a single model is a plain Gaussian.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple, Protocol

import numpy as np

from concord.features.several_targets.association.weights import (
    Association,
    Weights,
    association_weights,
)
from concord.features.several_targets.tracking.tracks import Tracks, joined_tracks, no_tracks
from concord.filters import ukf
from concord.filters.gaussian import Gaussian, stacked_size
from concord.filters.interacting_models import InteractingModels, Mode
from concord.filters.linalg import (
    cholesky,
    inverse_of_triangle,
    inverse_spd,
    multiply,
    symmetrise,
    times_transposed,
)
from concord.filters.moments import Model
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, sigma_points

_TINY = float(np.finfo(float).tiny)


class ScanSensor(Protocol):
    """A sensor that returns any number of detections (D, m) without names."""

    @property
    def noise_cov(self) -> np.ndarray:
        """Covariance (m, m) of a detection."""
        ...

    def measure(self, state: np.ndarray) -> np.ndarray:
        """Return the detections (..., m) of states (..., n), without noise."""
        ...

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., m), angles within half a turn."""
        ...

    def detection_probability(self, state: np.ndarray) -> np.ndarray:
        """Return that of states (..., n): (...); 0 outside the field of view."""
        ...

    def clutter_density(self, detections: np.ndarray) -> np.ndarray:
        """Return the expected clutter (D,) per unit of the measurement, above 0."""
        ...

    def begun(self, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return means (D, n) and covariances (D, n, n) of tracks that begin with these."""
        ...


class TrackerSettings(NamedTuple):
    """Models and thresholds of a tracker.

    Attributes:
        transition: states (..., n) -> (..., n), one step later.
        process_noise_cov: (n, n), what the step adds.
        points: sigma points for n states.
        associate: weights -> probabilities (`filters.association.associate.ASSOCIATIONS`).
        gate_probability: probability that the detection of a target is within its gate.
        survival: probability that a target is still there one step later.
        birth: existence of a track that begins with a detection that no track claims.
        confirm_at: existence from which a track is reported.
        end_below: existence below which a track ends.
        position: entries of the state that are a position.
        lost_above: root mean square error of the position, as believed, above which a track ends:
            no sensor has seen it for long.
        same_within: squared Mahalanobis distance of two states within which they are one target;
            the younger track ends.
        modes: models of motion between which a target changes.
        change: probability of a change in a step.
        unseen_std: standard deviations of the last states, of which a first detection says nothing.
    """

    transition: Model
    process_noise_cov: np.ndarray
    points: SigmaPointRule
    associate: Callable[[Weights], Association]
    gate_probability: float = 0.999
    survival: float = 0.99
    birth: float = 0.02
    confirm_at: float = 0.95
    end_below: float = 0.002
    position: tuple[int, ...] = (0, 2)
    lost_above: float = 100.0
    same_within: float = 2.0
    modes: tuple[Mode, ...] = (Mode(),)
    change: float = 0.0
    unseen_std: tuple[float, ...] = ()

    @property
    def models(self) -> InteractingModels:
        """The models of motion, which predict the belief of a track."""
        states = self.points.unit_points.shape[1]
        return InteractingModels(SigmaPointFilter(self.points), states, self.modes, self.change)

    @property
    def start(self) -> "Tracked":
        """No track."""
        states = self.points.unit_points.shape[1]
        return Tracked(no_tracks(stacked_size(states, len(self.modes))), 0)

    def begun(self, mean: np.ndarray, cov: np.ndarray) -> Gaussian:
        """The beliefs of tracks that begin with states (D, n - u), whose last u are not seen."""
        if not self.unseen_std:
            return self.models.begun(Gaussian(mean, cov))
        seen, unseen = mean.shape[-1], len(self.unseen_std)
        whole = np.zeros((len(mean), seen + unseen, seen + unseen))
        whole[:, :seen, :seen], whole[:, seen:, seen:] = cov, np.diag(np.square(self.unseen_std))
        mean = np.concatenate((mean, np.zeros((len(mean), unseen))), axis=1)
        return self.models.begun(Gaussian(mean, whole))


class Scan(NamedTuple):
    """Detections (D, m) that one sensor took in one step; `number` is that of the sensor."""

    number: int
    sensor: ScanSensor
    detections: np.ndarray


class Tracked(NamedTuple):
    """Tracks after a step, and how many clusters were beyond the bound of the exact sum."""

    tracks: Tracks
    approximated: int


def track(tracks: Tracks, scans: Sequence[Scan], settings: TrackerSettings, step: int) -> Tracked:
    """The tracks one step later, given the scans of this step in any order."""
    belief, models = tracks.belief, settings.models
    if len(tracks.existence):
        belief = models.predict(belief, settings.transition, settings.process_noise_cov)
    tracks = tracks._replace(belief=belief, existence=settings.survival * tracks.existence)
    places, cov = list(settings.position), models.moments(belief).cov
    tracks = tracks.chosen(cov[:, places, places].sum(axis=1) <= settings.lost_above**2)
    approximated = 0
    for scan in sorted(scans, key=lambda scan: scan.number):
        ordered = scan._replace(detections=in_order(scan.detections))
        tracks, clusters = _scanned(tracks, ordered, settings, step)
        approximated += clusters
    tracks = tracks.chosen(_apart(models.moments(tracks.belief), settings.same_within))
    reached = tracks.existence >= settings.confirm_at
    return Tracked(tracks._replace(confirmed=tracks.confirmed | reached), approximated)


def in_order(detections: np.ndarray) -> np.ndarray:
    """Return detections (D, m) in the order of their values, the first entry first."""
    # The two zeros of a float are equal in the order, but not in their bits.
    detections = detections + 0.0
    return detections[np.lexsort(detections.T[::-1])]


def _scanned(
    tracks: Tracks, scan: Scan, settings: TrackerSettings, step: int
) -> tuple[Tracks, int]:
    """Return the tracks after one scan, and its clusters beyond the bound."""
    unclaimed, approximated = np.ones(len(scan.detections)), 0
    moments = settings.models.moments(tracks.belief)
    probability = _detection_probability(moments, scan.sensor, settings.points)
    seen = probability > 0
    if seen.any():
        within = tracks.chosen(seen)
        updated, association = _updated(within, scan, settings, probability[seen])
        tracks = _replaced(tracks, seen, updated)
        unclaimed = 1 - association.hit.sum(axis=0)
        approximated = association.approximated
        tracks = tracks.chosen(tracks.existence >= settings.end_below)
    existence = settings.birth * unclaimed
    begins = existence > settings.end_below
    if begins.any():
        places = np.flatnonzero(begins)
        younger = Tracks(
            settings.begun(*scan.sensor.begun(scan.detections[begins])),
            existence[begins],
            np.stack(np.broadcast_arrays(step, scan.number, places), axis=-1),
            np.zeros(len(places), dtype=bool),
        )
        tracks = joined_tracks(tracks, younger)
    return tracks, approximated


def _detection_probability(
    belief: Gaussian, sensor: ScanSensor, points: SigmaPointRule
) -> np.ndarray:
    """Mean detection probability (T,) of beliefs: a track at the edge of a field is half in it."""
    values = sensor.detection_probability(sigma_points(belief, points))
    return np.clip(np.einsum("s,st->t", points.mean_weights, values), 0, 1)


def _updated(
    tracks: Tracks, scan: Scan, settings: TrackerSettings, probability: np.ndarray
) -> tuple[Tracks, Association]:
    """Return the tracks given the scan, and which detections belong to which."""
    sensor, prior, models = scan.sensor, tracks.existence, settings.models
    size, gate_probability = scan.detections.shape[-1], settings.gate_probability
    means, covs, logs = models.apart(tracks.belief)
    predicted, cov, cross_cov = ukf.measured(
        Gaussian(means, covs), sensor.measure, size, settings.points, sensor.residual
    )
    whitener = inverse_of_triangle(cholesky(cov + sensor.noise_cov))
    innovation = sensor.residual(scan.detections, predicted[..., None, :])
    whitened = np.einsum("tjab,tjdb->tjda", whitener, innovation)
    chance = np.exp(logs)
    # Each model gates by itself, so a target is within the gate with the same probability in all.
    hit = association_weights(
        whitened,
        whitener,
        probability[:, None],
        prior[:, None] * chance,
        sensor.clutter_density(scan.detections),
        gate_probability,
        _gate(size, gate_probability),
    ).hit
    weights = Weights(1 - prior * probability * gate_probability, hit.sum(axis=1))
    association = settings.associate(weights)
    # A track without a detection may also be one whose target does not exist.
    undetected = association.miss * prior * (1 - probability * gate_probability) / weights.miss
    existence = undetected + association.hit.sum(axis=1)
    # Of each model and detection, given that the target exists.
    there = np.maximum(existence, _TINY)[:, None, None]
    share = association.hit[:, None] * (hit / np.maximum(weights.hit, _TINY)[:, None]) / there
    after = chance * undetected[:, None] / there[..., 0] + share.sum(axis=-1)
    after = np.maximum(after, _TINY)
    share /= after[..., None]
    gain = times_transposed(cross_cov, whitener)
    # The mean and covariance of the mixture of all choices, in whitened innovations.
    mean = np.einsum("tjd,tjda->tja", share, whitened)
    spread = np.einsum("tjd,tjda,tjdb->tjab", share, whitened, whitened)
    spread -= mean[..., :, None] * mean[..., None, :]
    spread -= share.sum(axis=-1)[..., None, None] * np.eye(size)
    belief = models.stacked(
        means + multiply(gain, mean), symmetrise(covs + gain @ spread @ gain.mT), np.log(after)
    )
    return tracks._replace(belief=belief, existence=existence), association


@cache
def _gate(size: int, probability: float) -> float:
    """Return the chi-square threshold of detections of so many numbers."""
    # Only here: a node without several targets need not load it.
    from scipy.special import gammaincinv

    return float(2 * gammaincinv(size / 2, probability))


def _replaced(tracks: Tracks, seen: np.ndarray, updated: Tracks) -> Tracks:
    mean, cov, existence = (
        tracks.belief.mean.copy(),
        tracks.belief.cov.copy(),
        tracks.existence.copy(),
    )
    mean[seen], cov[seen], existence[seen] = *updated.belief, updated.existence
    return tracks._replace(belief=Gaussian(mean, cov), existence=existence)


def _apart(belief: Gaussian, same_within: float) -> np.ndarray:
    """Return which tracks (T,) do not stand for the target of an older one."""
    mean, cov = belief
    count = len(mean)
    older, younger = np.triu_indices(count, 1)
    # Tracks far apart need no matrix: the trace bounds the greatest eigenvalue.
    scale = np.trace(cov, axis1=-2, axis2=-1)
    away = mean[older] - mean[younger]
    near = np.vecdot(away, away) <= same_within * (scale[older] + scale[younger])
    kept = np.ones(count, dtype=bool)
    if not near.any():
        return kept
    older, younger, away = older[near], younger[near], away[near]
    both = cov[older] + cov[younger]
    distance = np.vecdot(away, multiply(inverse_spd(both), away))
    for first, second in zip(
        older[distance <= same_within], younger[distance <= same_within], strict=True
    ):
        if kept[first]:
            kept[second] = False
    return kept
