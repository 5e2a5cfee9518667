"""Bound on covariances: that of a filter that hears every sensor without loss.

The bound holds for linear plants and sensors whose models the filters know. There, no estimate has
a smaller error covariance than the Kalman filter with all readings. A covariance that is smaller in
any direction is therefore wrong. Unlike a large squared error, a wrong covariance shows in the very
step in which information is counted twice.
"""

import numpy as np

from concord.experiments.simulation_testing.broken import Broken
from concord.experiments.simulation_testing.promises import (
    BOUNDED,
    LINEAR,
    nodes_are_honest,
    promises,
)
from concord.experiments.simulation_testing.verdict import EstimateHistory
from concord.results.figures.posterior_bound import Truths, posterior_bound
from concord.scenarios.catalogue import definition_of
from concord.scenarios.types.plants import noise_of
from concord.scenarios.types.rules import number_of

# Of the bound: differences and inverses on both sides, and numbers of single length on the bus.
_ROUNDING = {"float64": 1e-6, "float32": 1e-3}


def check_bound(run: EstimateHistory) -> None:
    """Check that no covariance is smaller than that of the baseline filter.

    Raises:
        Broken: one is.
    """
    scenario = run.setup.scenario
    if not (scenario.name in LINEAR and noise_of(scenario.plant) == "matched"):
        return
    if not (promises(scenario, BOUNDED) and nodes_are_honest(scenario)):
        return
    bound = _bound(run)
    # A node that is out of the network has no belief.
    cov = np.where(np.isnan(run.cov), bound[:, None], run.cov)
    whitener = np.linalg.inv(np.linalg.cholesky(bound))[:, None]
    share = np.linalg.eigvalsh(whitener @ cov @ whitener.mT)[..., 0]
    step, node = np.unravel_index(np.argmin(share), share.shape)
    if (
        share[step, node]
        < 1 - _ROUNDING["float32" if number_of(scenario.rule) == "float32" else "float64"]
    ):
        raise Broken(
            "nobody is surer than who hears all",
            f"node {node} in step {step} believes {share[step, node]:.6g} of that variance",
        )


def _bound(run: EstimateHistory) -> np.ndarray:
    """Covariance (steps, n, n) of the filter with every reading that there is."""
    scenario = run.setup.scenario
    definition = definition_of(scenario)
    groups = definition.sensor_groups(scenario)
    # Of a linear plant it hangs on which readings come, and on no number in them.
    control = None if run.control is None else run.control[None]
    truths = Truths(run.truth[None], run.readings[None], control)
    return posterior_bound(
        truths, np.array(run.setup.prior_cov), definition.model(scenario), groups
    )
