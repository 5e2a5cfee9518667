"""The network's fusion rules as linear maps of errors, for `concord.studies.exact.averaged_errors`.

With given covariances every rule is linear in the errors. A node's prediction errs by e (n,). Its
reading adds the score s = H' R^-1 v (n,), of covariance W = H' R^-1 H. Its own update leaves the
error P_u (P^-1 e + s) with P_u^-1 = P^-1 + W. L rounds in which all nodes publish are one average
with the weights A = Pi^L, because each rule only averages numbers.

A rule maps predicted covariances (..., N, n, n), averaging weights A (..., N, N) and information W
(N, n, n) to a `Fusion`. The functions of the network's rules are evaluated at unit errors, which
gives their gains without a rounding error of finite differences.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.filters.fusion import hybrid_consensus, information_weighted
from concord.filters.fusion.averaging import INFORMATION, MOMENTS, Averaging
from concord.filters.fusion.packed import packed_length
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import symmetrise


class Fusion(NamedTuple):
    """Covariances that the nodes report after the rounds, and the gains behind their errors.

    covs: (..., N, n, n). Block (i, j) of error_gain and score_gain (..., N, N, n, n) multiplies the
    predicted error and the score of node j in the error of node i.
    """

    covs: np.ndarray
    error_gain: np.ndarray
    score_gain: np.ndarray


Rule = Callable[[np.ndarray, np.ndarray, np.ndarray], Fusion]


class _Averaged(NamedTuple):
    """A rule as what it averages.

    `express(prior, posterior)` are the numbers (..., N, m) of nodes, and `from_numbers(numbers)`
    the beliefs that averages come to. The first `pairs` parts of the numbers are packed pairs.
    """

    express: Callable[[Gaussian, Gaussian], np.ndarray]
    from_numbers: Callable[[np.ndarray], Gaussian]
    pairs: int = 1


def _of_beliefs(rule: Averaging, nodes: int, states: int) -> _Averaged:
    origin = np.zeros(states)
    return _Averaged(
        lambda _, posterior: rule.to_numbers(posterior, origin)[0],
        lambda numbers: rule.from_numbers(numbers, origin),
    )


def _hybrid(nodes: int, states: int) -> _Averaged:
    return _Averaged(
        partial(hybrid_consensus.begin, row=np.eye(nodes)),
        partial(hybrid_consensus.from_information, states=states),
        pairs=2,
    )


def _weighted_information(nodes: int, states: int) -> _Averaged:
    return _Averaged(
        partial(information_weighted.begin, nodes=nodes),
        partial(information_weighted.from_information, nodes=nodes),
    )


def _fusion(
    rule_of: Callable[[int, int], _Averaged],
    covs: np.ndarray,
    averaging: np.ndarray,
    information: np.ndarray,
) -> Fusion:
    """Evaluate a rule at no error, and at a unit of each error and each score of every node."""
    nodes, n = covs.shape[-3:-1]
    rule = rule_of(nodes, n)
    updated = symmetrise(np.linalg.solve(np.eye(n) + covs @ information, covs))
    unit, none = np.broadcast_to(np.eye(n), covs.shape), np.zeros(covs.shape)
    # The columns are the means of the lanes.
    priors = np.concatenate((none[..., :1], unit, none), axis=-1)
    posteriors = np.concatenate((none[..., :1], unit - updated @ information, updated), axis=-1)
    numbers = rule.express(_lanes(priors, covs), _lanes(posteriors, updated))
    vectors = [pair * packed_length(n) + k for pair in range(rule.pairs) for k in range(n)]
    probes = np.eye(numbers.shape[-1])[vectors]
    probes = np.concatenate((0 * probes[:1], probes))
    probes = np.expand_dims(probes, tuple(range(1, numbers.ndim - 1)))
    mean, fused = rule.from_numbers(averaging @ numbers[0] + probes)
    # Entry k of the average moves the mean of node i by `slope`; errors of j move it by `effect`.
    slope = np.moveaxis(mean[1:], 0, -1)[..., :, None, :, :]
    effect = np.moveaxis(numbers[1:][..., vectors], 0, -1)[..., None, :, :, :]
    gain = averaging[..., None, None] * (slope @ effect)
    return Fusion(fused[0], gain[..., :n], gain[..., n:])


def _lanes(columns: np.ndarray, covs: np.ndarray) -> Gaussian:
    """Columns (..., n, K) as means (K, ..., n) with equal covariances (..., n, n)."""
    mean = np.moveaxis(columns, -1, 0)
    return Gaussian(mean, np.broadcast_to(covs, (*mean.shape, mean.shape[-1])))


RULES: dict[str, Rule] = {
    "wac": partial(_fusion, partial(_of_beliefs, MOMENTS)),
    "ci": partial(_fusion, partial(_of_beliefs, INFORMATION)),
    "hcmci": partial(_fusion, _hybrid),
    "icf": partial(_fusion, _weighted_information),
}
