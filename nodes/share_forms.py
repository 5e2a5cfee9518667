"""Forms of a share on the wire that round to the safe side.

A sender that rounds a belief sends another mean, and perhaps a smaller covariance. The forms of
this file enlarge the covariance before the share is sent, so that for every belief (x, P)

    P_decoded >= P + (x_decoded - x) (x_decoded - x)'

holds as matrices. The decoded belief is consistent if the belief was, as long as the rounding of
the mean is not correlated with its error. That is so for steps far smaller than the deviation.

Two facts are used. An off-diagonal error of at most e sqrt(D_ii D_jj) in each place is at most
(n - 1) e D. And d d' <= n diag(d_1^2, ..., d_n^2) for any vector d.

Source: the enlargement by a diagonally dominant matrix is that of Funk, Noack and Hanebeck (2021),
Conservative quantization of covariance matrices with applications to decentralized information
fusion, Sensors 21(9). The scales, and the form of novelties, are this project's.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from concord.filters.fusion.packed import pack, packed_length, unpack
from concord.filters.gaussian import (
    Gaussian,
    Information,
    stacked_blocks,
    stacked_size,
    to_gaussian,
    to_information,
)
from concord.filters.linalg import (
    above_diagonal,
    cholesky,
    inverse_of_triangle,
    multiply,
    pack_upper,
    unpack_upper,
)

# Relative errors of a float32 that was rounded to the nearest, and of sums of a few doubles.
_SINGLE = 2.0**-24
_DOUBLE = 2.0**-40
# The mean goes in steps of a 32nd of the deviation, so an int16 reaches 1,023 deviations.
_MEAN_STEP = 2.0**-5
MEAN_ERROR = 0.5 * _MEAN_STEP
_LARGEST = 2**15 - 1
MEAN_REACH = _LARGEST * _MEAN_STEP
# Correlations, -1 to 1, and rows of weights, 0 to 1.
_CORRELATION_STEP = 2.0**-15
_WEIGHT_STEP = 1.0 / (2**16 - 1)
# Averages of decoded numbers often lie on a boundary of rounding. Drivers whose sums differ in the
# last bits then round alike. The loss, of this part of a step, is below that of float32.
_NUDGE = 1e-6
# Numbers that are not finite become codes that say so, without a warning.
_QUIET = np.errstate(over="ignore", invalid="ignore", divide="ignore")
# Codes of numbers that are not finite.
UNREADABLE = np.uint16(0xFFFF)
# The least normal float32.
_LEAST = 2.0**-126
# Part of the prior's variance that pays for the rounding of novelties.
_SLACK = 2.0**-7
# The scale of a novelty may cost at most this part of the prior's information.
_MOST_LOST = 0.5


class ShareForm(Protocol):
    """How numbers (..., m) become codes on the wire, and what a receiver reads in them."""

    @property
    def length(self) -> int:
        """How many codes a share has."""
        ...

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """The codes (..., length) of numbers (..., m)."""
        ...

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """The numbers (..., m) in codes (..., length); any codes are some, or NaN."""
        ...


@dataclass(frozen=True)
class AboutOrigin:
    """The `form` of numbers that begin with a mean, which it writes about an origin (n,)."""

    form: ShareForm
    origin: tuple[float, ...]

    @property
    def length(self) -> int:
        """That of the form."""
        return self.form.length

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Codes of the difference."""
        n = len(self.origin)
        about = np.concatenate((numbers[..., :n] - self.origin, numbers[..., n:]), axis=-1)
        return self.form.codes(about)

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """The numbers with the origin added."""
        found, n = self.form.numbers(codes), len(self.origin)
        return np.concatenate((found[..., :n] + self.origin, found[..., n:]), axis=-1)


@dataclass(frozen=True)
class SingleBelief:
    """Mean and upper triangle of the covariance of `states` dimensions, as float32."""

    states: int

    @property
    def length(self) -> int:
        """One code a number."""
        return packed_length(self.states)

    @_QUIET
    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Float32, the variances enlarged by what both roundings lose."""
        n = self.states
        mean, cov = numbers[..., :n], unpack_upper(numbers[..., n:])
        variances = np.diagonal(cov, axis1=-2, axis2=-1)
        enlarged = (n + 2) * _SINGLE * variances + n * (_SINGLE * mean) ** 2 + n * _LEAST
        cov = cov + np.eye(n) * enlarged[..., None, :]
        return np.concatenate((mean, pack_upper(cov)), axis=-1).astype("<f4")

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """The same in float64."""
        return codes.astype(np.float64)


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
        found = np.zeros((*codes.shape[:-1], packed_length(size)))
        found[..., self._places] = codes
        return found


@dataclass(frozen=True)
class TwoByteBelief:
    """A belief of `states` dimensions in two bytes a number, whatever the units of its states.

    Codes: the mean in parts of the deviations, int16; the variances, rounded up to 8 bits of
    exponent and 8 of mantissa; the upper triangle of the correlations without its diagonal, int16.
    Where a mean is more than 1,023 deviations from zero, its variance is enlarged until it is not.
    `slack` is a part of the variances by which they are enlarged further.
    """

    states: int
    slack: float = 0.0

    @property
    def length(self) -> int:
        """One code a number."""
        return packed_length(self.states)

    @property
    def _lost(self) -> float:
        """The part of enlarged variances that roundings may take."""
        n = self.states
        of_mean = n * MEAN_ERROR**2
        return ((n - 1) * 0.5 * _CORRELATION_STEP + of_mean) * (1.0 + 1e-5) + self.slack + _DOUBLE

    @_QUIET
    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Codes, uint16; those of a belief that is not finite say so."""
        n = self.states
        mean, cov = numbers[..., :n], unpack_upper(numbers[..., n:])
        needed = np.diagonal(cov, axis1=-2, axis2=-1) / (1.0 - self._lost)
        reach = np.abs(mean) / MEAN_REACH
        variances = _rounded_up(np.maximum(needed, (reach * (1.0 + _DOUBLE)) ** 2))
        deviations = np.sqrt(_of_positive(variances))
        means = _integers(mean / (deviations * _MEAN_STEP))
        places = above_diagonal(n)
        scale = deviations[..., places[0]] * deviations[..., places[1]]
        correlations = _integers(cov[..., places[0], places[1]] / scale / _CORRELATION_STEP)
        sound = np.isfinite(numbers).all(axis=-1, keepdims=True)
        sound = sound & (np.diagonal(cov, axis1=-2, axis2=-1) >= 0).all(axis=-1, keepdims=True)
        codes = np.concatenate((means, variances, correlations), axis=-1)
        return np.where(sound, codes, UNREADABLE)

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """Mean, then upper triangle; NaN where a variance is."""
        n = self.states
        variances = _of_positive(codes[..., n : 2 * n])
        deviations = np.sqrt(variances)
        mean = _signed(codes[..., :n]) * (deviations * _MEAN_STEP)
        cov = np.zeros((*codes.shape[:-1], n, n))
        places = above_diagonal(n)
        scale = deviations[..., places[0]] * deviations[..., places[1]]
        cov[..., places[0], places[1]] = _signed(codes[..., 2 * n :]) * _CORRELATION_STEP * scale
        cov[..., np.arange(n), np.arange(n)] = variances
        return np.concatenate((mean, pack_upper(cov)), axis=-1)


@dataclass(frozen=True)
class InformationPair:
    """A packed information pair that is positive definite, in the form of its belief."""

    belief: SingleBelief | TwoByteBelief

    @property
    def length(self) -> int:
        """One code a number."""
        return self.belief.length

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """The codes of the belief."""
        mean, cov = to_gaussian(unpack(numbers))
        return self.belief.codes(np.concatenate((mean, pack_upper(cov)), axis=-1))

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """The information pair of the belief in the codes."""
        return pack(to_information(_belief_of(self.belief.numbers(codes), self.belief.states)))


@dataclass(frozen=True)
class SingleNovelty:
    """A packed novelty of `states` states, and `more` numbers without a covariance, as float32.

    A novelty is the information of readings, and its rounding acts as more noise of theirs. Its
    matrix loses what its rounding could gain, so a novelty of some directions alone may take a
    little prior information in the others. A receiver refuses it where it takes all. The rounding
    of the vector counts state by state, which is a bound where the matrix is diagonal. Rules with
    such shares claim no bound either, but `centralised`.
    """

    states: int
    more: int = 0

    @property
    def length(self) -> int:
        """One code a number."""
        return packed_length(self.states) + self.more

    @_QUIET
    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Float32, the novelty as of noisier readings."""
        n, length = self.states, packed_length(self.states)
        vector, matrix = numbers[..., :n], unpack_upper(numbers[..., n:length])
        seen = np.diagonal(matrix, axis1=-2, axis2=-1)
        moved = np.where(seen > 0, (_SINGLE * vector) ** 2 / np.where(seen > 0, seen, 1.0), 0.0)
        kept = 1.0 / (1.0 + n * moved.sum(axis=-1, keepdims=True))
        least = matrix - np.eye(n) * ((n + 2) * _SINGLE * np.abs(seen))[..., None, :]
        novelty = kept * np.concatenate((vector, pack_upper(least)), axis=-1)
        return np.concatenate((novelty, numbers[..., length:]), axis=-1).astype("<f4")

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """The same in float64."""
        return codes.astype(np.float64)


@dataclass(frozen=True)
class SingleHybrid:
    """Prior information, novelty and row of weights as in `TwoByteHybrid`, as float32.

    The variances of the prior have a slack for the rounding of the novelty's vector. A novelty that
    would take a slack of more than half, or half of the prior's information, is sent as if it were
    noisier.
    """

    states: int
    nodes: int

    @property
    def _prior(self) -> SingleBelief:
        return SingleBelief(self.states)

    @property
    def length(self) -> int:
        """One code a number."""
        return 2 * packed_length(self.states) + self.nodes

    @_QUIET
    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Float32 codes; NaN where numbers are not finite."""
        n, length = self.states, packed_length(self.states)
        prior, novelty = (
            to_gaussian(unpack(numbers[..., :length])),
            numbers[..., length:][..., :length],
        )
        pull, added = _whitened(prior, unpack(novelty))
        # At the largest gain, in standard deviations of the prior; twice, as the slack adds some.
        lost = 2.0 * n * self.nodes * _SINGLE
        largest = np.abs(added).max(axis=(-1, -2), keepdims=True)[..., 0]
        far = lost * np.abs(pull).max(axis=-1, keepdims=True)
        fewer = np.maximum(1.0, np.maximum(lost * largest, far) / _MOST_LOST)
        # A power of two, so that the last bits of means, by driver, leave the covariance alone.
        slack = np.exp2(2.0 * np.ceil(np.log2(far / fewer)))
        variances = np.diagonal(prior.cov, axis1=-2, axis2=-1)
        cov = prior.cov + np.eye(n) * (slack * variances)[..., None, :]
        codes = self._prior.codes(np.concatenate((prior.mean, pack_upper(cov)), axis=-1))
        pull, added = _whitened(_belief_of(self._prior.numbers(codes), n), unpack(novelty))
        added = added / fewer[..., None]
        rounded = added.astype(np.float32)
        errors = np.abs(rounded - added).sum(axis=-1)
        errors += _SINGLE * np.abs(np.diagonal(added, axis1=-2, axis2=-1)) + _LEAST
        least = (added - np.eye(n) * errors[..., None, :]).astype(np.float32)
        weights = numbers[..., 2 * length :]
        row = weights.astype(np.float32)
        row = np.where(row < weights, np.nextafter(row, np.float32(np.inf)), row)
        return np.concatenate(
            (codes, pull / fewer, pack_upper(least), row), axis=-1, dtype="<f4", casting="same_kind"
        )

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """Prior information, novelty and row; NaN where one of them cannot be read."""
        n, length = self.states, packed_length(self.states)
        belief = _belief_of(self._prior.numbers(codes[..., :length]), n)
        numbers = codes[..., length:].astype(np.float64)
        pull, added = numbers[..., :n], unpack_upper(numbers[..., n:length])
        return _hybrid(belief, pull, added, numbers[..., length:])


@dataclass(frozen=True)
class TwoByteHybrid:
    """Prior information, novelty and row of weights of `nodes` nodes (`hybrid_consensus`).

    Codes: the prior's belief; the novelty in coordinates in which that belief, as decoded, is
    standard normal; the weights, rounded up. The matrix of the novelty is rounded down about the
    decoded mean: the part that is lost is prior information not used, which leaves the result
    consistent while it is at most all of it. Where a gain of N could cost more than half of it, the
    novelty is sent as if it were noisier. The rounding of the vector acts as an error of the prior,
    for which its variances have a slack.
    """

    states: int
    nodes: int

    @property
    def _prior(self) -> TwoByteBelief:
        return TwoByteBelief(self.states, _SLACK)

    @property
    def length(self) -> int:
        """One code a number, and the scale of the novelty's matrix."""
        return 2 * packed_length(self.states) + self.nodes + 1

    @property
    def _vector_step(self) -> float:
        """N^2 n step^2 / 4 <= slack / n, as P_decoded <= n diag P_decoded."""
        return 2.0 * np.sqrt(_SLACK) / (self.states * self.nodes)

    @_QUIET
    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Codes, uint16; those of numbers that are not finite say so."""
        n, length = self.states, packed_length(self.states)
        mean, cov = to_gaussian(unpack(numbers[..., :length]))
        prior = self._prior.codes(np.concatenate((mean, pack_upper(cov)), axis=-1))
        decoded = _belief_of(self._prior.numbers(prior), n)
        pull, added = _whitened(decoded, unpack(numbers[..., length : 2 * length]))
        # With this largest entry, N n times the matrix's step is as much as may be lost.
        reach = _MOST_LOST * _LARGEST / (n * self.nodes)
        largest = np.abs(added).max(axis=(-1, -2), keepdims=True)[..., 0]
        excess = np.abs(pull).max(axis=-1, keepdims=True) / (_LARGEST * self._vector_step)
        fewer = np.maximum(1.0, np.maximum(largest / reach, excess))
        scale = _rounded_up((1.0 + _DOUBLE) * largest / fewer)
        step = _of_positive(scale) / _LARGEST
        rounded = _rounded_down(added / fewer[..., None] / step[..., None])
        row = np.ceil(numbers[..., 2 * length :] / _WEIGHT_STEP - _NUDGE)
        codes = (
            prior,
            _integers(pull / fewer / self._vector_step),
            _integers(pack_upper(rounded)),
            np.clip(np.nan_to_num(row), 0, 2**16 - 1).astype(np.uint16),
            scale,
        )
        sound = np.isfinite(numbers).all(axis=-1, keepdims=True) & np.isfinite(fewer)
        return np.where(sound, np.concatenate(codes, axis=-1), UNREADABLE)

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """Prior information, novelty and row; NaN where one of them cannot be read."""
        n, length = self.states, packed_length(self.states)
        belief = _belief_of(self._prior.numbers(codes[..., :length]), n)
        step = _of_positive(codes[..., -1:]) / _LARGEST
        added = unpack_upper(_signed(codes[..., length + n : 2 * length]) * step)
        pull = _signed(codes[..., length : length + n]) * self._vector_step
        return _hybrid(belief, pull, added, codes[..., 2 * length : -1] * _WEIGHT_STEP)


def _belief_of(numbers: np.ndarray, states: int) -> Gaussian:
    return Gaussian(numbers[..., :states], unpack_upper(numbers[..., states:]))


def _whitened(prior: Gaussian, novelty: Information) -> tuple[np.ndarray, np.ndarray]:
    """Vector and matrix of a novelty in coordinates in which the prior is standard normal."""
    factor = cholesky(prior.cov)
    pull = multiply(factor.mT, novelty.vector - multiply(novelty.matrix, prior.mean))
    return pull, factor.mT @ novelty.matrix @ factor


def _hybrid(prior: Gaussian, pull: np.ndarray, added: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Prior information, the novelty that `_whitened` makes (pull, added) of, and the row."""
    whitener = inverse_of_triangle(cholesky(prior.cov))
    matrix = whitener.mT @ added @ whitener
    matrix = 0.5 * (matrix + matrix.mT)
    vector = multiply(whitener.mT, pull) + multiply(matrix, prior.mean)
    pairs = pack(to_information(prior)), pack(Information(vector, matrix))
    return np.concatenate((*pairs, row), axis=-1)


def _rounded_up(values: np.ndarray) -> np.ndarray:
    """Codes of positive values: the upper bits of a float32 without sign, uint16."""
    single = np.maximum(values, _LEAST).astype(np.float32)
    single = np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    bits = np.ascontiguousarray(single, np.float32).view(np.uint32)
    return np.minimum((bits + 0x7FFF) >> 15, UNREADABLE).astype(np.uint16)


def _of_positive(codes: np.ndarray) -> np.ndarray:
    """The values of such codes; NaN for what was too large, or not a number."""
    bits = np.ascontiguousarray(codes, np.uint16).astype(np.uint32) << 15
    values = bits.view(np.float32).astype(np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def _integers(values: np.ndarray) -> np.ndarray:
    """The nearest int16, as uint16; 0 for what is not a number."""
    rounded = np.minimum(np.maximum(np.rint(values - _NUDGE), -_LARGEST), _LARGEST)
    return np.where(np.isnan(rounded), 0, rounded).astype(np.int16).view(np.uint16)


def _signed(codes: np.ndarray) -> np.ndarray:
    """The int16 in codes, as float64."""
    return np.ascontiguousarray(codes, np.uint16).view(np.int16).astype(np.float64)


def _rounded_down(matrix: np.ndarray) -> np.ndarray:
    """Integers (..., n, n) that are at most the matrix: less by what each row's rounding gained."""
    rounded = np.rint(matrix - _NUDGE)
    n = matrix.shape[-1]
    diagonal = np.eye(n, dtype=bool)
    errors = np.where(diagonal, 0.0, np.abs(rounded - matrix)).sum(axis=-1)
    least = np.floor(np.diagonal(matrix, axis1=-2, axis2=-1) - errors + _NUDGE)
    return np.where(diagonal, least[..., None, :], rounded)
