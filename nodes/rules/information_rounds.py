"""Rules whose every round is a weighted average of all that is known (HCMCI, ICF)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from filters.fusion.packed import average
from filters.gaussian import Gaussian
from nodes.messages import Array


class InformationRounds(NamedTuple):
    """Averages by the weights, renormalised over the heard neighbours (`fresh_consensus.Exchange`).

    `open(node, prior, posterior)` is what is known (..., m) before the first round,
    `conclude(known)` the belief that an average comes to, `check(shares)` tells sound ones.
    """

    open: Callable[[np.ndarray, Gaussian, Gaussian], Array]
    conclude: Callable[[Array], Gaussian]
    check: Callable[[Array], np.ndarray]

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> Array:
        """Return the numbers that the rule averages (..., m)."""
        return self.open(node, prior, posterior)

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """Return the whole content."""
        return known

    def sound(self, shares: Array) -> np.ndarray:
        """Which of shares (..., m) are of nodes in their senses: (...) bool."""
        return self.check(shares)

    def usable(self, prior: Gaussian, shares: Array) -> None:
        """A share is sound or not by itself."""

    def fuse(
        self,
        cycle: int,
        weights: Array,
        prior: Gaussian,
        known: Array,
        belief: Gaussian,
        shares: Array,
    ) -> tuple[Array, Gaussian]:
        """The average of shares (..., 1 + J, m), and the belief that it comes to."""
        mixed = average(shares, weights)
        return mixed, self.conclude(mixed)
