"""How likely each track gives each detection, next to the likelihood that it was not detected."""

from typing import NamedTuple

import numpy as np


class Weights(NamedTuple):
    """Weights of the choices of T tracks among D detections.

    A joint hypothesis has the product of its choices as its weight, in units of the hypothesis that
    all detections are clutter.

    Attributes:
        miss: (T,), the track gave no detection.
        hit: (T, D), the track gave this detection; 0 outside its gate.
    """

    miss: np.ndarray
    hit: np.ndarray


class Association(NamedTuple):
    """Probabilities of the choices of T tracks among D detections, each row sums to 1.

    Attributes:
        miss: (T,), the track gave no detection.
        hit: (T, D), the track gave this detection.
        approximated: number of clusters that were beyond the bound of the exact sum.
    """

    miss: np.ndarray
    hit: np.ndarray
    approximated: int


def association_weights(
    whitened: np.ndarray,
    whitener: np.ndarray,
    detection_probability: np.ndarray,
    existence: np.ndarray,
    clutter_density: np.ndarray,
    gate_probability: float,
    gate: float,
) -> Weights:
    """Weights of a scan; each track may have further axes, as one of its models.

    Args:
        whitened: (T, ..., D, m), detection minus prediction, times the whitener.
        whitener: (T, ..., m, m), inverse of the Cholesky factor of the innovation covariance.
        detection_probability: (T, ...), of each track by this sensor.
        existence: (T, ...), probability that the target of the track is there.
        clutter_density: (D,), expected number of clutter detections per unit of the measurement.
        gate_probability: probability that the detection of a target is within the gate.
        gate: greatest squared Mahalanobis distance, the quantile of `gate_probability` of the
            chi-square distribution with m degrees of freedom.

    Returns:
        Those of the probabilistic data association filter with the existence of the target
        (Musicki and Evans 2004, Joint integrated probabilistic data association, IEEE Trans. AES
        40(3), equations 15 and 16).
    """
    distance = np.vecdot(whitened, whitened)
    size = whitened.shape[-1]
    peak = np.abs(np.diagonal(whitener, axis1=-2, axis2=-1)).prod(-1) / (2 * np.pi) ** (size / 2)
    hit = np.exp(-0.5 * distance) * (existence * detection_probability * peak)[..., None]
    hit = np.where(distance <= gate, hit / clutter_density, 0.0)
    return Weights(1 - existence * detection_probability * gate_probability, hit)
