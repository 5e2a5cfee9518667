"""Fusion rules as linear maps of errors, for `papers.wac.exact_covariance`.

With given covariances every rule is linear in the errors. A node's prediction errs by e (n,). Its
reading adds the score s = H' R^-1 v (n,), of covariance W = H' R^-1 H. Its own update leaves the
error P_u (P^-1 e + s) with P_u^-1 = P^-1 + W. L rounds in which all nodes publish are one average
with the weights A = Pi^L, because each rule only averages moments or information.

A rule maps predicted covariances (..., N, n, n), averaging weights A (..., N, N) and information W
(N, n, n) to a `Fusion`. The package `filters` holds the network's own rules and states their
properties. The rules here are written independently, so that each checks the other.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from filters.linalg import inverse_spd, symmetrise


class Fusion(NamedTuple):
    """Covariances that the nodes report after the rounds, and the gains behind their errors.

    covs: (..., N, n, n). Block (i, j) of error_gain and score_gain (..., N, N, n, n) multiplies the
    predicted error and the score of node j in the error of node i.
    """

    covs: np.ndarray
    error_gain: np.ndarray
    score_gain: np.ndarray


Rule = Callable[[np.ndarray, np.ndarray, np.ndarray], Fusion]


def local(covs: np.ndarray, averaging: np.ndarray, information: np.ndarray) -> Fusion:
    """Every node by itself, whatever the weights."""
    alone = np.broadcast_to(np.eye(averaging.shape[-1]), averaging.shape)
    return _average_information(covs, alone, information, np.ones(averaging.shape[:-1]))


def weighted_average(covs: np.ndarray, averaging: np.ndarray, information: np.ndarray) -> Fusion:
    """WAC: x = sum a_j x_j, P = sum a_j P_j (Widjiantoro et al., beta 3). Inverts no P."""
    n = covs.shape[-1]
    updated = symmetrise(np.linalg.solve(np.eye(n) + covs @ information, covs))
    kept = np.eye(n) - updated @ information
    share = averaging[..., None, None]
    return Fusion(
        _average(averaging, updated), share * kept[..., None, :, :, :], share * _across(updated)
    )


def covariance_intersection(
    covs: np.ndarray, averaging: np.ndarray, information: np.ndarray
) -> Fusion:
    """CI: P^-1 = sum a_j P_j^-1 and P^-1 x = sum a_j P_j^-1 x_j (Battistelli, Chisci 2014)."""
    return _average_information(covs, averaging, information, np.ones(averaging.shape[:-1]))


def hcmci_safe(covs: np.ndarray, averaging: np.ndarray, information: np.ndarray) -> Fusion:
    """HCMCI: CI on predictions; novelties count g_i = 1 / max_j a_ij times their average."""
    return _average_information(covs, averaging, information, 1 / averaging.max(axis=-1))


def icf(covs: np.ndarray, averaging: np.ndarray, information: np.ndarray) -> Fusion:
    """ICF (Kamal et al. 2013), which is HCMCI with g = N, as if averages were complete."""
    nodes = averaging.shape[-1]
    return _average_information(
        covs, averaging, information, np.full(averaging.shape[:-1], float(nodes))
    )


def centralised(covs: np.ndarray, averaging: np.ndarray, information: np.ndarray) -> Fusion:
    """Every node has all readings, whatever the weights."""
    nodes = averaging.shape[-1]
    return icf(covs, np.full(averaging.shape, 1 / nodes), information)


RULES: dict[str, Rule] = {
    "local": local,
    "wac": weighted_average,
    "ci": covariance_intersection,
    "hcmci": hcmci_safe,
    "icf": icf,
    "centralised": centralised,
}


def _average_information(
    covs: np.ndarray, averaging: np.ndarray, information: np.ndarray, novelty_gain: np.ndarray
) -> Fusion:
    """P_i^-1 = sum_j a_ij (P_j^-1 + g_i W_j), and P_i^-1 e_i likewise; gains g (..., N)."""
    matrices = inverse_spd(covs)
    weighted = novelty_gain[..., None] * averaging
    total = _average(averaging, matrices) + _average(weighted, information)
    fused = inverse_spd(symmetrise(total))
    of_errors = fused[..., :, None, :, :] @ matrices[..., None, :, :, :]
    of_scores = _across(fused).swapaxes(-4, -3)
    return Fusion(
        fused, averaging[..., None, None] * of_errors, weighted[..., None, None] * of_scores
    )


def _average(averaging: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """sum_j a_ij M_j: (..., N, N), (..., N, n, n) -> (..., N, n, n)."""
    n = matrices.shape[-1]
    flat = matrices.reshape(*matrices.shape[:-2], n * n)
    average = averaging @ flat
    return average.reshape(*average.shape[:-1], n, n)


def _across(matrices: np.ndarray) -> np.ndarray:
    """Block (i, j) = M_j: (..., N, n, n) -> (..., N, N, n, n)."""
    *lead, nodes, n, _ = matrices.shape
    return np.broadcast_to(matrices[..., None, :, :, :], (*lead, nodes, nodes, n, n))
