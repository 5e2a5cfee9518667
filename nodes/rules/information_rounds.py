"""Rules whose every round is a weighted average of all that is known (HCMCI, ICF)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.filters.fusion.packed import average
from concord.filters.gaussian import Gaussian


class InformationRounds(NamedTuple):
    """Averages by the weights, renormalised over the heard neighbours (`fresh_consensus.Exchange`).

    `open(node, prior, posterior)` is what is known (..., m) before the first round,
    `from_information(known)` the belief that an average comes to, `check(shares)` tells sound ones.
    """

    open: Callable[[np.ndarray, Gaussian, Gaussian], np.ndarray]
    from_information: Callable[[np.ndarray], Gaussian]
    check: Callable[[np.ndarray], np.ndarray]

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        """Return the numbers that the rule averages (..., m)."""
        return self.open(node, prior, posterior)

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        """Return the whole content."""
        return known

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
