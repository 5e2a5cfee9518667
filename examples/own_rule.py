"""A fusion rule of your own beside those of concord: the mean of the means, and the widest cov.

`concord run --rule examples/own_rule.py:cautious` runs it too.
"""

import numpy as np

import concord as cc
from concord.filters.gaussian import Gaussian


def cautious(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Beliefs (..., J, n) and weights (..., J) to one belief (..., n)."""
    heard = weights > 0
    share = np.where(heard, weights, 0) / np.where(heard, weights, 0).sum(-1, keepdims=True)
    mean = (share[..., None] * np.where(heard[..., None], beliefs.mean, 0)).sum(-2)
    trace = np.where(heard, np.trace(beliefs.cov, axis1=-2, axis2=-1), -np.inf)
    widest = trace.argmax(-1)[..., None, None, None]
    return Gaussian(mean, np.take_along_axis(beliefs.cov, widest, axis=-3)[..., 0, :, :])


if __name__ == "__main__":
    scenario = cc.scenario("oscillator", nodes=6, steps=60)
    table = cc.sweep(scenario, rule=["ci", "wac", cautious], runs=10)
    error = table["rmse"].mean("run").to_series()
    # A rule of a file has its path in its name.
    print(error.rename(lambda rule: rule.rpartition("/")[2]).to_string())
