"""Split covariance intersection: what a node's own reading of the step brought is independent of
all others, and only the rest is fused with caution.

A share is a mean, the covariance D of the errors that others may share, and the covariance I of
those that are the node's own: 2 (n + n (n + 1) / 2) - n numbers. After the first round of a step
nothing is the node's own any more. Source: Julier and Uhlmann (2001), General decentralized data
fusion with covariance intersection, in the Handbook of Multisensor Data Fusion, section 12.4.

    concord run --scenario oscillator --rule examples/rules/split_intersection.py:SPLIT
"""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import pack_upper, unpack_upper
from concord.nodes.rules.fresh_consensus import FreshConsensus
from concord.scenarios.node_context import RuleContext
from concord.scenarios.rule_table.rule import ShareKind, once

_WEIGHTS = np.linspace(0.02, 0.98, 25)


class Split:
    """Shares (..., m) are mean, packed D and packed I; an `Exchange` of `fresh_consensus`."""

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        """With gain K: D = (1 - K H) P (1 - K H)' of the prior, I = K R K' of the reading."""
        kept = posterior.cov @ np.linalg.inv(prior.cov)
        shared = kept @ prior.cov @ kept.mT
        return numbers(posterior.mean, shared, posterior.cov - shared)

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        return known

    def placed(self, cycle: int, shares: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
        mean, shared, own = parts(shares, states)
        return mean, np.diagonal(shared + own, axis1=-2, axis2=-1)

    def turned(self, cycle: int, shares: np.ndarray, turns: np.ndarray) -> np.ndarray:
        n = turns.shape[-1]
        return np.concatenate((shares[..., :n] + turns, shares[..., n:]), axis=-1)

    def sound(self, shares: np.ndarray) -> np.ndarray:
        return np.asarray(np.isfinite(shares).all(axis=-1))

    def usable(self, prior: Gaussian, shares: np.ndarray) -> None:
        return None

    def fuse(self, cycle: int, weights: np.ndarray, prior: Gaussian, known: np.ndarray,
             belief: Gaussian, shares: np.ndarray) -> tuple[np.ndarray, Gaussian]:  # fmt: skip
        """The own share with those that were heard, one after the other."""
        n = prior.mean.shape[-1]
        mean, shared, own = parts(shares[..., 0, :], n)
        for j in range(1, shares.shape[-2]):
            heard = np.asarray(np.isfinite(shares[..., j, :]).all(axis=-1))
            other = parts(np.where(heard[..., None], shares[..., j, :], shares[..., 0, :]), n)
            found = pair((mean, shared, own), other)
            mean = np.where(heard[..., None], found[0], mean)
            shared = np.where(heard[..., None, None], found[1], shared)
            own = np.where(heard[..., None, None], found[2], own)
        whole = shared + own
        return numbers(mean, whole, 0 * whole), Gaussian(mean, whole)


def numbers(mean: np.ndarray, shared: np.ndarray, own: np.ndarray) -> np.ndarray:
    """The three as one vector."""
    return np.concatenate((mean, pack_upper(shared), pack_upper(own)), axis=-1)


def parts(shares: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (..., n), D and I (..., n, n)."""
    mean, shared, own = np.split(shares, [n, n + n * (n + 1) // 2], axis=-1)
    return mean, unpack_upper(shared), unpack_upper(own)


def pair(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Two means with D and I, by the weight of least volume on a grid: mean, D and I."""
    (mean, shared, own), (other_mean, other_shared, other_own) = one, other

    def widened(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        here, there = shared / w + own, other_shared / (1 - w) + other_own
        return np.linalg.inv(here), np.linalg.inv(there)

    here, there = widened(_WEIGHTS.reshape(-1, *(1,) * shared.ndim))
    best = np.argmax(np.linalg.slogdet(here + there)[1], axis=0)
    here, there = widened(_WEIGHTS[best][..., None, None])
    cov = np.linalg.inv(here + there)
    gain, other_gain = cov @ here, cov @ there
    fused = (gain @ mean[..., None] + other_gain @ other_mean[..., None])[..., 0]
    apart = gain @ own @ gain.mT + other_gain @ other_own @ other_gain.mT
    return fused, cov - apart, apart


def built(context: RuleContext) -> FreshConsensus:
    """The rule at the nodes of a network."""
    of_plant = context.origin, context.angles
    return FreshConsensus(Split(), context.trigger, context.contends, *of_plant)


SPLIT = once(ShareKind("share", lambda states, _: states * (states + 2)), built)
