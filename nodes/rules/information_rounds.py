"""Rules whose every round is a weighted average of all that is known (HCMCI, ICF)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.filters.fusion.packed import (
    average,
    from_packed_information,
    pack,
    packed_length,
    unpack,
)
from concord.filters.gaussian import Gaussian
from concord.filters.turns import turned


class InformationRounds(NamedTuple):
    """Averages by the weights, renormalised over the heard neighbours (`fresh_consensus.Exchange`).

    `open(node, prior, posterior)` is what is known (..., m) before the first round,
    `from_information(known)` the belief that an average comes to, `check(shares)` tells sound ones.
    The numbers begin with so many packed `pairs`, the first of which is that of a belief.
    """

    open: Callable[[np.ndarray, Gaussian, Gaussian], np.ndarray]
    from_information: Callable[[np.ndarray], Gaussian]
    check: Callable[[np.ndarray], np.ndarray]
    pairs: int = 1

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        """Return the numbers that the rule averages (..., m)."""
        return self.open(node, prior, posterior)

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        """Return the whole content."""
        return known

    def placed(self, cycle: int, shares: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variances (..., n) of the first pair of shares (..., m)."""
        first = from_packed_information(shares[..., : packed_length(states)])
        return first.mean, np.diagonal(first.cov, axis1=-2, axis2=-1)

    def turned(self, cycle: int, shares: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Shares (..., m) whose pairs are on turns (..., n) in rad away."""
        length = packed_length(turns.shape[-1])
        parts = np.split(shares, [length * (1 + pair) for pair in range(self.pairs)], axis=-1)
        moved = [pack(turned(unpack(pair), turns)) for pair in parts[: self.pairs]]
        return np.concatenate((*moved, *parts[self.pairs :]), axis=-1)

    def sound(self, shares: np.ndarray) -> np.ndarray:
        """Which of shares (..., m) are of nodes in their senses: (...) bool."""
        return self.check(shares)

    def usable(self, prior: Gaussian, shares: np.ndarray) -> None:
        """A share is sound or not by itself."""

    def fuse(
        self,
        cycle: int,
        weights: np.ndarray,
        prior: Gaussian,
        known: np.ndarray,
        belief: Gaussian,
        shares: np.ndarray,
    ) -> tuple[np.ndarray, Gaussian]:
        """The average of shares (..., 1 + J, m), and the belief that it comes to."""
        mixed = average(shares, weights)
        return mixed, self.from_information(mixed)
