"""Shares of one direction: the one in which a node's own readings of the step helped most.

A share is a direction u (n,), the mean along it, and its variance: n + 2 numbers in place of n + n
(n + 1) / 2. It is fused by covariance intersection of a whole belief with a part of one. Source:
Forsling, Noack and Hendeby (2024), A quarter century of covariance intersection: correlations still
unknown?, IEEE Control Systems 44. Dimension reduction by generalised eigenvalues as in Forsling,
Sjanic, Gustafsson and Hendeby (2022), Communication efficient decentralized track fusion.

    concord run --scenario oscillator --rule examples/rules/few_directions.py:DIRECTIONS
"""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.rules.fresh_consensus import FreshConsensus
from concord.scenarios.node_context import RuleContext
from concord.scenarios.rule_table.rule import ShareKind, once

_WEIGHTS = np.linspace(0.02, 0.98, 25)


class Directions:
    """Shares (..., n + 2) are u, u' x and u' P u; an `Exchange` of `fresh_consensus`."""

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        return share(prior, posterior)

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        return known

    def placed(self, cycle: int, shares: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
        mean = shares[..., :states] * shares[..., -2:-1]
        return mean, np.ones_like(mean)

    def turned(self, cycle: int, shares: np.ndarray, turns: np.ndarray) -> np.ndarray:
        along = (shares[..., :-2] * turns).sum(axis=-1, keepdims=True)
        return np.concatenate((shares[..., :-2], shares[..., -2:-1] + along, shares[..., -1:]), -1)

    def sound(self, shares: np.ndarray) -> np.ndarray:
        return np.isfinite(shares).all(axis=-1) & (shares[..., -1] > 0)

    def usable(self, prior: Gaussian, shares: np.ndarray) -> None:
        return None

    def fuse(self, cycle: int, weights: np.ndarray, prior: Gaussian, known: np.ndarray,
             belief: Gaussian, shares: np.ndarray) -> tuple[np.ndarray, Gaussian]:  # fmt: skip
        """The own belief with the directions that were heard, one after the other."""
        mean, cov = belief
        for j in range(1, shares.shape[-2]):
            heard = np.asarray(np.isfinite(shares[..., j, :]).all(axis=-1))
            other = np.where(heard[..., None], shares[..., j, :], known)
            found = with_direction(Gaussian(mean, cov), other)
            mean = np.where(heard[..., None], found.mean, mean)
            cov = np.where(heard[..., None, None], found.cov, cov)
        fused = Gaussian(mean, cov)
        return share(prior, fused), fused


def share(prior: Gaussian, belief: Gaussian) -> np.ndarray:
    """The direction of the largest ratio of prior to present variance."""
    root = np.linalg.cholesky(belief.cov)
    white = np.linalg.solve(root, np.linalg.solve(root, prior.cov).mT)
    turn = np.linalg.eigh((white + white.mT) / 2)[1][..., -1]
    u = np.linalg.solve(root.mT, turn[..., None])[..., 0]
    u = u / np.linalg.norm(u, axis=-1, keepdims=True)
    variance = (u[..., None, :] @ belief.cov @ u[..., None])[..., 0]
    return np.concatenate((u, (u * belief.mean).sum(-1, keepdims=True), variance), axis=-1)


def with_direction(belief: Gaussian, heard: np.ndarray) -> Gaussian:
    """Covariance intersection of a belief (..., n) with one direction, the least volume on a grid.

    The determinant of w P^-1 + (1 - w) u u' / r is w^n (1 + (1 - w) s / (w r)) / |P|, with s = u'
    P u the own variance along u.
    """
    u, value, variance = heard[..., :-2], heard[..., -2], heard[..., -1]
    n, along = u.shape[-1], (belief.cov @ u[..., None])[..., 0]
    own = (u * along).sum(axis=-1)
    w = np.append(_WEIGHTS, 1.0).reshape(-1, *(1,) * own.ndim)
    ratio = own / variance
    best = np.argmax(n * np.log(w) + np.log1p((1 - w) / w * ratio), axis=0)
    w = np.append(_WEIGHTS, 1.0)[best]
    gain = (along / w[..., None]) / (own / w + variance / np.maximum(1 - w, 1e-12))[..., None]
    mean = belief.mean + gain * (value - (u * belief.mean).sum(axis=-1))[..., None]
    cov = (belief.cov - gain[..., None] * along[..., None, :]) / w[..., None, None]
    return Gaussian(mean, (cov + cov.mT) / 2)


def built(context: RuleContext) -> FreshConsensus:
    """The rule at the nodes of a network."""
    of_plant = context.origin, context.angles
    return FreshConsensus(Directions(), context.trigger, context.contends, *of_plant)


DIRECTIONS = once(ShareKind("share", lambda states, _: states + 2), built)
