"""Nobody is surer than a filter that hears every sensor without loss.

Where plant and sensors are linear and as believed, no estimate of anything that nodes can know has
a smaller error covariance than the Kalman filter with all readings; so a covariance that is smaller
in any direction is a false one, whatever the readings say. Unlike a squared error it needs no luck
to be found out: what is counted twice shows in the step in which it is.
"""

import numpy as np

from experiments.posterior_bound import Truths, posterior_bound
from experiments.torture_broken import Broken
from experiments.torture_promises import BOUNDED, LINEAR, nodes_are_honest, promises
from experiments.torture_verdict import History
from scenarios.catalogue import kind_of

# Of the bound: differences and inverses on both sides, and numbers of single length on the bus.
_ROUNDING = {"float64": 1e-6, "float32": 1e-3}


def check_bound(run: History) -> None:
    """No covariance is smaller than that of the filter that hears everybody.

    Raises:
        Broken: one is.
    """
    scenario = run.setup.scenario
    if not (scenario.name in LINEAR and scenario.noise == "matched"):
        return
    if not (promises(scenario, BOUNDED) and nodes_are_honest(scenario)):
        return
    bound = _bound(run)
    # Who is out believes nothing.
    cov = np.where(np.isnan(run.cov), bound[:, None], run.cov)
    whitener = np.linalg.inv(np.linalg.cholesky(bound))[:, None]
    share = np.linalg.eigvalsh(whitener @ cov @ whitener.mT)[..., 0]
    step, node = np.unravel_index(np.argmin(share), share.shape)
    if share[step, node] < 1 - _ROUNDING[scenario.number]:
        raise Broken(
            "nobody is surer than who hears all",
            f"node {node} in step {step} believes {share[step, node]:.6g} of that variance",
        )


def _bound(run: History) -> np.ndarray:
    """Covariance (steps, n, n) of the filter with every reading that there is."""
    scenario = run.setup.scenario
    kind = kind_of(scenario.name)
    sensors = [kind.sensor(scenario, node) for node in range(scenario.nodes)]
    # Of a linear plant it hangs on which readings come, and on no number in them.
    control = None if run.control is None else run.control[None]
    truths = Truths(run.truth[None], run.readings[None], control)
    return posterior_bound(truths, np.array(run.setup.prior_cov), kind.model(scenario), sensors)
