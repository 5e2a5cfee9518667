"""How good the estimates of one step are, and what all nodes together believe."""

import numpy as np

from concord.dashboard.frames.frame import StepScores
from concord.dashboard.frames.stage import Stage
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import inverse_spd, multiply
from concord.scenarios.catalogue import scored_nees

# Of the largest value: sums of doubles are exact to some 1e-16 of it.
_ROUNDING = 1e-13


def fuse(belief: Gaussian, alive: np.ndarray) -> Gaussian:
    """Return the mean of the living nodes (N, n) in information form: mean (n,), cov (n, n).

    It is covariance intersection with equal weights, towards which the nodes of a connected network
    tend. NaN where nobody believes anything.
    """
    n = belief.mean.shape[-1]
    usable = alive & ~np.isnan(belief.mean).any(-1)
    matrices = inverse_spd(belief.cov[usable])
    sound = ~np.isnan(matrices).any((-1, -2))
    if not sound.any():
        return Gaussian(np.full(n, np.nan), np.full((n, n), np.nan))
    vectors = multiply(matrices[sound], belief.mean[usable][sound])
    cov = inverse_spd(matrices[sound].mean(0))
    return Gaussian(multiply(cov, vectors.mean(0)), cov)


def score(
    stage: Stage,
    truth: np.ndarray,
    belief: Gaussian,
    alive: np.ndarray,
    fused: Gaussian,
    central: Gaussian | None,
) -> StepScores:
    """The scores of a step for truth (n,) and beliefs (N, n), which together believe `fused`;
    `central` heard everything."""
    states = list(stage.score.states)
    off = belief.mean - truth
    error = np.linalg.norm(off[:, states], axis=-1)
    variances = np.diagonal(belief.cov, axis1=-2, axis2=-1)[:, states]
    living = alive & ~np.isnan(belief.mean).any(-1)
    consistency = scored_nees(stage.setup.scenario, off[living], belief.cov[living])
    means = belief.mean[living][:, states]
    return StepScores(
        error=error,
        width=np.sqrt(np.maximum(variances, 0.0).sum(-1)),
        rmse=_root_mean_square(error[living]),
        spread=_spread(means),
        nees=float(np.nan) if stage.set_valued else _mean(consistency),
        central=_error(central, truth, states),
        fused=_error(fused, truth, states),
    )


def with_errors(scores: StepScores, errors: np.ndarray) -> StepScores:
    """The scores of a step with these errors of the nodes (K,) as the error of the network.

    The errors of each node stay those of its belief. The centralised filter of the page and the
    fused belief have no such error.
    """
    rmse = _root_mean_square(errors)
    return scores._replace(rmse=rmse, central=float("nan"), fused=float("nan"))


def _spread(means: np.ndarray) -> float:
    """Root mean square distance of means (N, d) from their mean; what is rounding is none."""
    if len(means) < 2:
        return float("nan")
    spread = _root_mean_square(np.linalg.norm(means - means.mean(0), axis=-1))
    return 0.0 if spread <= _ROUNDING * float(np.nanmax(np.abs(means))) else spread


def _error(belief: Gaussian | None, truth: np.ndarray, states: list[int]) -> float:
    if belief is None:
        return float("nan")
    return float(np.linalg.norm((belief.mean - truth)[states]))


def _mean(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")


def _root_mean_square(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")
