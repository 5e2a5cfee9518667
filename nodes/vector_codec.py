"""A vector of numbers as bytes."""

import math
import struct
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import pack_upper, unpack_upper
from concord.nodes.estimator import Rejected
from concord.nodes.share_forms import UNREADABLE, ShareForm


@dataclass(frozen=True)
class VectorCodec:
    """How a vector of `length` numbers is written, each as `number`: "<f8", "<f4" or "<u2".

    With a form, the codes of that are written in place of the numbers; "<u2" needs one. A body that
    is no such vector is refused as `{what}-length` or `{what}-not-finite`.
    """

    length: int
    number: str = "<f8"
    what: str = "share"
    form: ShareForm | None = None

    @property
    def exact(self) -> bool:
        """Whether a receiver reads the very numbers that were sent."""
        return self.number == "<f8"

    @cached_property
    def size(self) -> int:
        """Length in bytes of an encoded vector."""
        codes = self.length if self.form is None else self.form.length
        return codes * self._dtype.itemsize

    @cached_property
    def _dtype(self) -> np.dtype:
        return np.dtype(self.number)

    @cached_property
    def _numbers(self) -> struct.Struct:
        return struct.Struct(f"<{self.size // self._dtype.itemsize}{self._dtype.char}")

    def encode(self, vector: np.ndarray) -> bytes:
        """The bytes of a vector (length,)."""
        return self._written(vector).tobytes()

    def received(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., length) as a receiver reads them."""
        return vectors if self.exact else self.read(self._written(vectors))

    def _written(self, vectors: np.ndarray) -> np.ndarray:
        if self.form is not None:
            return self.form.codes(vectors)
        return vectors.astype(self._dtype, copy=False)

    def read(self, codes: np.ndarray) -> np.ndarray:
        """The vectors (..., length) in codes."""
        if self.form is not None:
            return self.form.numbers(codes)
        return codes.astype(np.float64, copy=False)

    def check(self, body: bytes) -> bytes:
        """A body without its padding, of which a vector can be read.

        Raises:
            Rejected: the body is too short, or a number is not finite.
        """
        # A static slot may pad the body; anything shorter is not a share of this network.
        size = self.size
        if len(body) < size:
            raise Rejected(f"{self.what}-length")
        body = body[:size]
        if self._dtype.kind != "f":
            finite = bool(np.isfinite(_decoded(self, body)).all())
        else:
            # Finite numbers may have an infinite sum, but no sum of others is finite.
            numbers = self._numbers.unpack(body)
            finite = math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))
        if not finite:
            raise Rejected(f"{self.what}-not-finite")
        return body

    def unpack(self, *bodies: bytes) -> np.ndarray:
        """The vectors (K, length) in K bodies that were checked."""
        if self.form is not None:
            return np.array([_decoded(self, body) for body in bodies]).reshape(-1, self.length)
        codes = np.frombuffer(b"".join(bodies), self._dtype)
        return self.read(codes.reshape(-1, self.length))

    def decode(self, body: bytes) -> np.ndarray:
        """The vector (length,) that `encode` wrote.

        Raises:
            Rejected: as `check`.
        """
        return self.unpack(self.check(body))[0]


# Kept: a share has as many receivers as its sender has neighbours, and each checks it first.
@lru_cache(4096)
def _decoded(codec: VectorCodec, body: bytes) -> np.ndarray:
    """The vector (length,) in a body that is long enough."""
    numbers = codec.read(np.frombuffer(body, codec.number))
    numbers.setflags(write=False)
    return numbers


def not_numbers(count: int, number: str) -> bytes:
    """So many codes that no receiver can read."""
    if np.dtype(number).kind == "f":
        return np.full(count, np.nan, number).tobytes()
    return np.full(count, UNREADABLE, number).tobytes()


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
