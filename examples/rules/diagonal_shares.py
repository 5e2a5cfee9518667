"""Shares of a mean and a diagonal covariance, widened until it bounds the whole one: 2 n numbers.

Fused by covariance intersection with the consensus weights. Source: Forsling, Noack and Hendeby
(2021), Consistent distributed track fusion under communication constraints, FUSION; the scaled
diagonal of their section on diagonal covariance approximation.

    concord run --scenario oscillator --rule examples/rules/diagonal_shares.py:DIAGONAL
"""

import numpy as np

from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.fresh_consensus import FreshConsensus
from concord.scenarios.node_context import RuleContext
from concord.scenarios.rule_table.rule import ShareKind, once


class Diagonal:
    """Shares (..., 2 n) are the mean and n variances; an `Exchange` of `fresh_consensus`."""

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        return share(posterior)

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        return known

    def placed(self, cycle: int, shares: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
        return shares[..., :states], shares[..., states:]

    def turned(self, cycle: int, shares: np.ndarray, turns: np.ndarray) -> np.ndarray:
        n = turns.shape[-1]
        return np.concatenate((shares[..., :n] + turns, shares[..., n:]), axis=-1)

    def sound(self, shares: np.ndarray) -> np.ndarray:
        variances = shares[..., shares.shape[-1] // 2 :]
        return np.asarray(np.isfinite(shares).all(axis=-1) & (variances > 0).all(axis=-1))

    def usable(self, prior: Gaussian, shares: np.ndarray) -> None:
        return None

    def fuse(self, cycle: int, weights: np.ndarray, prior: Gaussian, known: np.ndarray,
             belief: Gaussian, shares: np.ndarray) -> tuple[np.ndarray, Gaussian]:  # fmt: skip
        """The whole own belief with the diagonal ones that were heard."""
        n = belief.mean.shape[-1]
        means, variances = shares[..., :n].copy(), shares[..., n:]
        covs = variances[..., None] * np.eye(n)
        means[..., 0, :], covs[..., 0, :, :] = belief.mean, belief.cov
        used = np.where(np.isfinite(means).all(axis=-1), weights, 0.0)
        used = used / used.sum(axis=-1, keepdims=True)
        fused = covariance_intersection(Gaussian(means, covs), used)
        return share(fused), fused


def share(belief: Gaussian) -> np.ndarray:
    """Mean, and the diagonal times the largest eigenvalue of the correlations."""
    variances = np.diagonal(belief.cov, axis1=-2, axis2=-1)
    std = np.sqrt(variances)
    largest = np.linalg.eigvalsh(belief.cov / (std[..., None] * std[..., None, :]))[..., -1:]
    return np.concatenate((belief.mean, largest * variances), axis=-1)


def built(context: RuleContext) -> FreshConsensus:
    """The rule at the nodes of a network."""
    of_plant = context.origin, context.angles
    return FreshConsensus(Diagonal(), context.trigger, context.contends, *of_plant)


DIAGONAL = once(ShareKind("share", lambda states, _: 2 * states), built)
