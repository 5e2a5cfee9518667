"""The filter of the consensus paper, (alpha 1) to (beta 5), with its errors one at a time.

The correct filter updates at each node, averages the pairs over the network, and draws its points
anew. An erratum replaces one formula by the printed one. Where the printed shapes do not fit, or a
covariance loses its root, there is no number.
"""

from typing import NamedTuple

import numpy as np

from concord.features.control.cruise import cruise
from concord.features.control.motor import motor_position
from concord.filters.linalg import cholesky, symmetrise
from concord.papers.kit.judging import Check, at_most
from concord.papers.kit.report import Section, markdown_table
from concord.plants.linear import LinearPlant
from concord.topology.graphs import ring
from concord.topology.weights import metropolis

ROUNDS, STEPS, RUNS, FIRST = 3, 120, 24, 40
ERRORS = {
    "none": "the corrected filter",
    "12": "one W for means and covariances",
    "13 Q": "(alpha 4) without Q",
    "13 R": "(alpha 7) without R",
    "13": "neither Q nor R, as printed",
    "14": "(alpha 5): propagated points used again",
    "15 cross": "(alpha 8): y^(i) - x",
    "15 z": "(alpha 10): z = y - y^(i), of the last point",
    "17": "L + 1 averages",
    "all": "all of these, as printed",
}


class PrintedOutcome(NamedTuple):
    """RMSE of the output's state over that of the corrected filter, ANEES; NaN for no number."""

    ratio: float
    anees: float


def measure(seed: int) -> dict[str, dict[str, PrintedOutcome]]:
    """By plant and error."""
    plants = {"cruise": cruise(), "position": motor_position()}
    return {
        name: {error: _scored(plant, error, seed) for error in ERRORS}
        for name, plant in plants.items()
    }


def section(place: int, outcomes: dict[str, dict[str, PrintedOutcome]]) -> Section:
    """The table, and the checks of what theory says of it."""
    rows = []
    for error, words in ERRORS.items():
        row = [error, words]
        for found in outcomes.values():
            ratio = found[error].ratio / found["none"].ratio
            one = found[error].anees
            row += ["no number" if np.isnan(ratio) else f"{ratio:.3g}",
                    "-" if np.isnan(one) else f"{one:.3g}"]  # fmt: skip
        rows.append(row)
    head = ["erratum", "printed formula"]
    head += [f"{name} {what}" for name in outcomes for what in ("RMSE ratio", "ANEES")]
    text = (
        f"Eight nodes on a ring, {ROUNDS} averages, matched noise, {RUNS} runs of {STEPS} steps. "
        "On linear plants one W changes nothing, as the points lie about their mean. Nor does "
        "(alpha 8), whose wrong centre drops out where its shape fits at all.\n\n"
    )
    checks: list[Check] = []
    for name, found in outcomes.items():
        checks.append(at_most(f"{name}: ANEES of the corrected filter", found["none"].anees, 1.0))
        same = abs(found["12"].ratio / found["none"].ratio - 1)
        checks.append(at_most(f"{name}: one W on a linear plant", same, 1e-9))
    data = {name: {k: v._asdict() for k, v in one.items()} for name, one in outcomes.items()}
    title = "The filter as printed, one error at a time"
    return Section(place, title, text + markdown_table(head, rows), checks, data=data)


def _scored(plant: LinearPlant, error: str, seed: int) -> PrintedOutcome:
    """Run one form on noise that all forms share."""
    draws = np.random.default_rng(seed)
    n, q = plant.noise_factor.shape
    nodes, outputs = plant.sensors.noise_std.shape
    rounds = ROUNDS + (error in ("17", "all"))
    averaging = np.linalg.matrix_power(metropolis(ring(nodes)).toarray(), rounds)
    start = draws.standard_normal((RUNS, n)) @ np.linalg.cholesky(plant.prior_cov).T
    truth = np.zeros((RUNS, n))
    mean = np.repeat(start[:, None], nodes, axis=1)
    cov = np.broadcast_to(plant.prior_cov, (RUNS, nodes, n, n))
    points = sigma_points(mean, cov)
    squares, scores = [], []
    for step in range(STEPS):
        noise = draws.standard_normal((RUNS, nodes, 1, outputs))
        read = plant.observe(truth, noise, step)[:, :, 0]
        try:
            mean, cov = _updated(plant, error, mean, cov, points, read)
        except ValueError:
            return PrintedOutcome(np.nan, np.nan)
        mean = np.einsum("kj,rjn->rkn", averaging, mean)
        cov = symmetrise(np.einsum("kj,rjnm->rknm", averaging, cov))
        away = mean - truth[:, None]
        squares.append(away[..., 0] ** 2)
        scores.append(_nees(away, cov))
        moved = sigma_points(mean, cov) @ plant.model.transition_matrix.T
        w_mean, w_cov = weights(n, error in ("12", "all"))
        mean = np.tensordot(w_mean, moved, axes=1)
        spread = moved - mean
        cov = np.einsum("s,skin,skim->kinm", w_cov, spread, spread)
        if error not in ("13 Q", "13", "all"):
            cov = cov + plant.model.noise_cov
        points = moved if error in ("14", "all") else sigma_points(mean, cov)
        truth = plant.advance(truth, None, draws.standard_normal((RUNS, q)), step)
    with np.errstate(invalid="ignore", over="ignore"):
        rmse = float(np.sqrt(np.mean(squares[FIRST:])))
    return PrintedOutcome(rmse, float(np.mean(scores[FIRST:])))


def _nees(away: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Squared errors per state in units of the covariance; NaN where it has no inverse."""
    if not np.isfinite(cov).all() or not np.linalg.det(cov).all():
        return np.full(away.shape[:-1], np.nan)
    return (away * np.linalg.solve(cov, away[..., None])[..., 0]).mean(axis=-1)


def _updated(
    plant: LinearPlant, error: str, mean: np.ndarray, cov: np.ndarray, points: np.ndarray,
    read: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(alpha 5) to (alpha 11) at all nodes that read something.

    Raises:
        ValueError: y^(i) - x of different lengths.
    """
    n = mean.shape[-1]
    w_mean, w_cov = weights(n, error in ("12", "all"))
    seen = (points[..., None, :] * plant.sensors.rows).sum(-1)
    predicted = np.tensordot(w_mean, seen, axes=1)
    away = seen - predicted
    crossed = away
    if error in ("15 cross", "all"):
        if n != away.shape[-1]:
            raise ValueError(f"(alpha 8) takes {n} states from {away.shape[-1]} outputs")
        crossed = seen - mean
    innovation_cov = np.einsum("s,skid,skie->kide", w_cov, away, away)
    blind = np.isnan(plant.sensors.noise_std)
    if error not in ("13 R", "13", "all"):
        variances = np.where(blind, 1.0, plant.sensors.noise_std) ** 2
        innovation_cov = innovation_cov + variances[..., None] * np.eye(variances.shape[-1])
    cross = np.einsum("s,skin,skid->kind", w_cov, points - mean, crossed)
    z = read - (seen[-1] if error in ("15 z", "all") else predicted)
    with np.errstate(invalid="ignore", divide="ignore"):
        # One output at a node: a division in place of an inverse that may not exist.
        gain = cross / innovation_cov
        updated = mean + (gain @ np.nan_to_num(z)[..., None])[..., 0]
        after = symmetrise(cov - gain @ innovation_cov @ gain.mT)
    there = np.logical_not(np.asarray(blind.all(axis=-1)))
    return (
        np.where(there[:, None], updated, mean),
        np.where(there[:, None, None], after, cov),
    )


def weights(n: int, is_one: bool) -> tuple[np.ndarray, np.ndarray]:
    """(29) with alpha = 1, beta = 2, kappa = 3 - n: of means and covariances, (2 n + 1,) each."""
    of_mean = np.full(2 * n + 1, 1 / 6)
    of_mean[0] = 1 - n / 3
    of_cov = of_mean.copy()
    of_cov[0] += 0.0 if is_one else 2.0
    return of_mean, of_cov


def sigma_points(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """(28): the mean, then both ways along the columns of a root: (2 n + 1, ..., n)."""
    root = np.sqrt(3.0) * np.moveaxis(cholesky(cov), -1, 0)
    return np.concatenate([mean[None], mean + root, mean - root])
