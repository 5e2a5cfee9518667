"""The errors of a linear network to second order, exactly: no random number is drawn.

The joint covariance E[e e'] of all nodes' errors, e = (e_1, ..., e_N), is carried beside the
covariances that the nodes report. In each step every node takes its reading, L rounds of fusion
follow, then all predict; the plant's noise is common to them. From both follow, with no sampling
error, how far a rule is from the centralised filter and whether it is overconfident.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from concord.filters.linalg import cholesky, inverse_spd, symmetrise
from concord.plants.linear import LinearPlant
from concord.studies.exact.averaged_rules import Fusion, Rule


class LinearNetwork(NamedTuple):
    """A linear plant and what the nodes' readings tell of it; no control, which moves no error.

    transition_matrix: F (n, n); noise_cov: Q (n, n); information: H_i' R_i^-1 H_i of every node
    (N, n, n), zero for a blind one; prior_cov: (n, n) of the one prior mean that all start from.
    """

    transition_matrix: np.ndarray
    noise_cov: np.ndarray
    information: np.ndarray
    prior_cov: np.ndarray


class Moments(NamedTuple):
    """A step after its last round.

    reported: the covariance each node believes, (..., N, n, n); errors: E[e e'], (..., N n, N n);
    central_cov: (n, n) of a filter that has all readings.
    """

    reported: np.ndarray
    errors: np.ndarray
    central_cov: np.ndarray


class ExactFigures(NamedTuple):
    """Per node, (..., N): 1 is the centralised filter in `relative_rmse`, consistent in the rest.

    relative_rmse: root of tr(P_c^-1 E_ii) / n, with P_c of the centralised filter.
    anees: tr(P_i^-1 E_ii) / n, the expectation of the normalised squared error.
    lambda_max: the largest eigenvalue of P_i^-1 E_ii; above 1 some direction is overconfident.
    disagreement: as relative_rmse, of the distance from the network's average.
    """

    relative_rmse: np.ndarray
    anees: np.ndarray
    lambda_max: np.ndarray
    disagreement: np.ndarray


def network_of(plant: LinearPlant) -> LinearNetwork:
    """The network of a plant and its sensors.

    Raises:
        ValueError: its filters believe another process noise than the truth has, so that what
            follows would not be its errors.
    """
    believed, true = plant.model.noise_cov, plant.noise_factor @ plant.noise_factor.T
    if not np.allclose(believed, true, rtol=1e-9, atol=0):
        raise ValueError(
            f"{plant.name}: filters believe another process noise than the plant has "
            "(noise='paper'); the exact covariance needs noise='matched'"
        )
    blind = np.isnan(plant.sensors.noise_std)
    precision = np.where(blind, 0.0, 1 / np.where(blind, 1.0, plant.sensors.noise_std) ** 2)
    rows = plant.sensors.rows
    information = rows.mT @ (precision[..., None] * rows)
    model = plant.model
    return LinearNetwork(model.transition_matrix, model.noise_cov, information, plant.prior_cov)


def propagate(
    network: LinearNetwork, rule: Rule, averaging: np.ndarray, steps: int
) -> Iterator[Moments]:
    """The moments of each step.

    Args:
        averaging: (..., N, N), the weight matrix to the power of the rounds; networks that differ
            in it alone go side by side.
    """
    F, Q, information, prior_cov = network
    nodes, n = information.shape[:2]
    every = np.kron(np.eye(nodes), F)
    common = np.tile(Q, (nodes, nodes))
    reported = np.broadcast_to(prior_cov, (*averaging.shape[:-1], n, n))
    # All nodes start from one prior mean, so they share its error.
    errors = np.tile(prior_cov, (nodes, nodes))
    central = prior_cov
    for _ in range(steps):
        fusion = rule(reported, averaging, information)
        errors = _fused_errors(fusion, errors, information)
        central = inverse_spd(symmetrise(inverse_spd(central) + information.sum(axis=0)))
        yield Moments(fusion.covs, errors, central)
        reported = symmetrise(F @ fusion.covs @ F.T + Q)
        errors = symmetrise(every @ errors @ every.T + common)
        central = symmetrise(F @ central @ F.T + Q)


def figures_of(moments: Moments) -> ExactFigures:
    """The figures of a step, per node."""
    nodes, n = moments.reported.shape[-3:-1]
    own = _diagonal_blocks(moments.errors, nodes)
    away = np.kron(np.eye(nodes) - 1 / nodes, np.eye(n))
    spread = _diagonal_blocks(away @ moments.errors @ away.T, nodes)
    whitener = np.linalg.inv(cholesky(moments.reported))
    ratio = np.linalg.eigvalsh(symmetrise(whitener @ own @ whitener.mT))
    central = inverse_spd(moments.central_cov)
    return ExactFigures(
        relative_rmse=np.sqrt(_trace(central @ own) / n),
        anees=ratio.mean(axis=-1),
        lambda_max=ratio[..., -1],
        disagreement=np.sqrt(np.maximum(_trace(central @ spread), 0.0) / n),
    )


def over_nodes(figures: ExactFigures) -> ExactFigures:
    """The network as a whole, (...): root mean square, mean, maximum, root mean square."""
    return ExactFigures(
        np.sqrt((figures.relative_rmse**2).mean(axis=-1)),
        figures.anees.mean(axis=-1),
        figures.lambda_max.max(axis=-1),
        np.sqrt((figures.disagreement**2).mean(axis=-1)),
    )


def _fused_errors(fusion: Fusion, errors: np.ndarray, information: np.ndarray) -> np.ndarray:
    """E[e e'] after the rounds from E[e e'] (..., N n, N n) of the predictions."""
    carried = _joined(fusion.error_gain)
    # Scores of different nodes are independent, each of covariance H' R^-1 H.
    weighed = _joined(fusion.score_gain @ information)
    noise = weighed @ _joined(fusion.score_gain).mT
    return symmetrise(carried @ errors @ carried.mT + noise)


def _joined(blocks: np.ndarray) -> np.ndarray:
    """(..., N, N, n, n) blocks as one matrix (..., N n, N n)."""
    *lead, nodes, _, n, _ = blocks.shape
    return blocks.swapaxes(-3, -2).reshape(*lead, nodes * n, nodes * n)


def _diagonal_blocks(matrix: np.ndarray, nodes: int) -> np.ndarray:
    """The blocks (..., N, n, n) on the diagonal of a matrix (..., N n, N n)."""
    n = matrix.shape[-1] // nodes
    blocks = matrix.reshape(*matrix.shape[:-2], nodes, n, nodes, n)
    return np.stack([blocks[..., i, :, i, :] for i in range(nodes)], axis=-3)


def _trace(matrix: np.ndarray) -> np.ndarray:
    return np.trace(matrix, axis1=-2, axis2=-1)
