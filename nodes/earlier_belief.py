"""A belief of an earlier step, from which a node begins anew."""

from typing import NamedTuple

import numpy as np

from concord.filters.filter import Filter, begun, moments
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.local_filter import Model, at, predict_to_step


class EarlierBelief(NamedTuple):
    """A belief (n,) about the state at `step`; `control` (p,) drove the plant last."""

    belief: Gaussian
    step: int
    control: np.ndarray | None = None

    def at_step(self, step: int, model: Model, filter: Filter) -> Gaussian:
        """Predict the belief to a step; it stays as it is where a prediction fails.

        The control of the steps between is not known: the last one is taken for each of them.
        """
        beliefs = begun(filter, Gaussian(self.belief.mean[None], self.belief.cov[None]))
        for number in range(self.step + 1, step + 1):
            moved, sound = predict_to_step(beliefs, self.control, number, model, filter)
            beliefs = moved if sound[0] else beliefs
        return at(moments(filter, beliefs), 0)
