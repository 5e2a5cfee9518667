"""A belief of several models on the wire: only the numbers that are not the same in all of them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from concord.filters.interacting_models import stacked_blocks, stacked_size
from concord.filters.linalg import pack_upper
from concord.nodes.share_forms import SingleBelief


@dataclass(frozen=True)
class StackedBelief:
    """A stacked belief (`filters/interacting_models.py`) of `models` models of `states` states.

    Codes: the means of the models and their log odds, then the upper triangle of the covariance
    without what lies between two blocks. float64, or with `is_single` float32 as `SingleBelief`.
    """

    states: int
    models: int
    is_single: bool

    @property
    def size(self) -> int:
        """Length of the mean."""
        return stacked_size(self.states, self.models)

    @property
    def length(self) -> int:
        """One code a number."""
        return len(self._places)

    @cached_property
    def _places(self) -> np.ndarray:
        blocks = pack_upper(stacked_blocks(self.states, self.models))
        return np.flatnonzero(np.concatenate((np.ones(self.size, dtype=bool), blocks)))

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """The codes of mean and upper triangle."""
        whole = SingleBelief(self.size).codes(numbers) if self.is_single else numbers
        return whole[..., self._places]

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """Mean and upper triangle, 0 between two blocks."""
        size = self.size
        found = np.zeros((*codes.shape[:-1], size * (size + 3) // 2))
        found[..., self._places] = codes
        return found
