"""A Gaussian as bytes: the mean, then the upper triangle of the covariance row by row."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import pack_upper, unpack_upper
from concord.nodes.share_forms import ShareForm
from concord.nodes.vector_codec import VectorCodec


def belief_numbers(belief: Gaussian) -> np.ndarray:
    """The numbers (..., m) of beliefs (..., n): mean, then upper triangle."""
    return np.concatenate((belief.mean, pack_upper(belief.cov)), axis=-1)


def belief_of(numbers: np.ndarray, states: int) -> Gaussian:
    """The beliefs (..., n) of numbers (..., m)."""
    return Gaussian(numbers[..., :states], unpack_upper(numbers[..., states:]))


@dataclass(frozen=True)
class BeliefCodec:
    """How a belief of `states` dimensions is written: numbers and form as of `VectorCodec`."""

    states: int
    number: str = "<f8"
    form: ShareForm | None = None

    @cached_property
    def vector(self) -> VectorCodec:
        """The codec of its numbers."""
        n = self.states
        return VectorCodec(n + n * (n + 1) // 2, self.number, "belief", self.form)

    @property
    def size(self) -> int:
        """Length in bytes of an encoded belief."""
        return self.vector.size

    def encode(self, belief: Gaussian) -> bytes:
        """The bytes of mean (n,) and cov (n, n)."""
        return self.vector.encode(belief_numbers(belief))

    def decode(self, body: bytes) -> Gaussian:
        """The belief that `encode` wrote.

        Raises:
            Rejected: `belief-length` or `belief-not-finite`.
        """
        return belief_of(self.vector.decode(body), self.states)
