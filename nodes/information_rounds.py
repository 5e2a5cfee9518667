"""Rules whose every round is a weighted average of all that is known (HCMCI, ICF)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from filters.packed import average
from nodes.messages import Array


class InformationRounds(NamedTuple):
    """Averages by `weights` (1 + J,), the node's own first, renormalised over who was heard.

    `open(prior, posterior)` is what is known (m,) before the first round, `conclude(known)` the
    belief that an average comes to, `check(shares (J, m))` tells sound ones (J,).
    """

    open: Callable[[Gaussian, Gaussian], Array]
    conclude: Callable[[Array], Gaussian]
    check: Callable[[Array], np.ndarray]
    weights: Array

    def begin(self, prior: Gaussian, posterior: Gaussian) -> Array:
        """What the rule averages (m,)."""
        return self.open(prior, posterior)

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """All that is known."""
        return known

    def sound(self, prior: Gaussian, shares: Array) -> np.ndarray:
        """Which of shares (J, m) are of nodes in their senses: (J,) bool."""
        return self.check(shares)

    def fuse(
        self, cycle: int, prior: Gaussian, known: Array, belief: Gaussian, shares: Array
    ) -> tuple[Array, Gaussian]:
        """The average of shares (1 + J, m), and the belief that it comes to."""
        mixed = average(shares, self.weights)
        return mixed, self.conclude(mixed)
