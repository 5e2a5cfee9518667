"""Rules that exchange their novelty once, then average means (diffusion, KCF, centralised)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.filters.fusion.packed import pack, packed_length, unpack
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, inverse_spd
from concord.filters.turns import turned


class NoveltyRounds(NamedTuple):
    """Round 0 absorbs the shares of all neighbours, later ones mix their means.

    `open(prior, posterior)` is what a node says first (..., m), its packed novelty in front;
    `absorb(prior, shares (..., 1 + J, m))` the belief after round 0; `mix(means (..., 1 + J, n),
    weights (..., 1 + J))` the mean after a later one. The node's own comes first; NaN was not
    heard. Means travel in vectors of the same length, as a bus slot has one. It is an `Exchange` of
    `fresh_consensus`.
    """

    open: Callable[[Gaussian, Gaussian], np.ndarray]
    absorb: Callable[[Gaussian, np.ndarray], Gaussian]
    mix: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        """Return the node's share of the first round (..., m)."""
        return self.open(prior, posterior)

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        """First what the own readings brought, then the mean, padded."""
        if cycle == 0:
            return known
        numbers = np.zeros_like(known)
        numbers[..., : belief.mean.shape[-1]] = belief.mean
        return numbers

    def placed(self, cycle: int, shares: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
        """The means (..., n) behind novelties, then means alone; the shares carry no variances."""
        means = shares[..., :states] if cycle > 0 else shares[..., -states:]
        return means, np.ones_like(means)

    def turned(self, cycle: int, shares: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Novelties with means behind, then means alone, on turns (..., n) in rad away."""
        n = turns.shape[-1]
        if cycle > 0:
            return np.concatenate((shares[..., :n] + turns, shares[..., n:]), axis=-1)
        novelty = turned(unpack(shares[..., :-n]), turns)
        return np.concatenate((pack(novelty), shares[..., -n:] + turns), axis=-1)

    def sound(self, shares: np.ndarray) -> np.ndarray:
        """Every share, as far as it alone can tell."""
        return np.ones(shares.shape[:-1], dtype=bool)

    def usable(self, prior: Gaussian, shares: np.ndarray) -> np.ndarray:
        """Which of shares (..., J, m) leave the own information positive definite: (..., J)."""
        packed = shares[..., : packed_length(prior.mean.shape[-1])]
        together = inverse_spd(prior.cov)[..., None, :, :] + unpack(packed).matrix
        return np.isfinite(cholesky(together)[..., -1, -1])

    def fuse(
        self,
        cycle: int,
        weights: np.ndarray,
        prior: Gaussian,
        known: np.ndarray,
        belief: Gaussian,
        shares: np.ndarray,
    ) -> tuple[np.ndarray, Gaussian]:
        """The prior with all novelties, then the mixed mean with the covariance that it had."""
        if cycle == 0:
            return known, self.absorb(prior, shares)
        means = shares[..., : belief.mean.shape[-1]]
        return known, Gaussian(self.mix(means, weights), belief.cov)
