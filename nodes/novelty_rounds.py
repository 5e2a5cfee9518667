"""Rules that exchange their novelty once, then average means (diffusion, KCF, centralised)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky, inverse_spd
from filters.packed import packed_length, unpack
from nodes.messages import Array


class NoveltyRounds(NamedTuple):
    """Round 0 absorbs what everybody in the neighbourhood says, later ones mix their means.

    `open(prior, posterior)` is what a node says first (m,), its packed novelty in front;
    `absorb(prior, shares (1 + J, m))` the belief after round 0; `mix(means (1 + J, n))` the mean
    after a later one. The node's own comes first; NaN was not heard. Means travel in vectors of the
    same length, as a bus slot has one. All may have leading axes, one entry a node.
    """

    open: Callable[[Gaussian, Gaussian], Array]
    absorb: Callable[[Gaussian, Array], Gaussian]
    mix: Callable[[Array], Array]

    def begin(self, prior: Gaussian, posterior: Gaussian) -> Array:
        """What the node says in the first round (m,)."""
        return self.open(prior, posterior)

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """First what the own readings brought, then the mean, padded."""
        if cycle == 0:
            return known
        said = np.zeros_like(known)
        said[..., : belief.mean.shape[-1]] = belief.mean
        return said

    def sound(self, prior: Gaussian, shares: Array) -> np.ndarray:
        """Which of shares (..., J, m) leave the own information positive definite: (..., J)."""
        packed = shares[..., : packed_length(prior.mean.shape[-1])]
        together = inverse_spd(prior.cov)[..., None, :, :] + unpack(packed).matrix
        return np.isfinite(cholesky(together)[..., -1, -1])

    def fuse(
        self, cycle: int, prior: Gaussian, known: Array, belief: Gaussian, shares: Array
    ) -> tuple[Array, Gaussian]:
        """The prior with all novelties, then the mixed mean with the covariance that it had."""
        if cycle == 0:
            return known, self.absorb(prior, shares)
        means = shares[..., : belief.mean.shape[-1]]
        return known, Gaussian(self.mix(means), belief.cov)
