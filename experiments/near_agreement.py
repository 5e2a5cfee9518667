"""How near the vectorised driver comes to a run that went message by message.

Sums in another order differ in their last bits, so equal here is equal to 1e-10 of the scale: that
of a mean is its size or its standard deviation, that of a covariance the standard deviations.
"""

import numpy as np

from experiments.trace import Trace
from experiments.vectorised import OPTIONAL, simulate
from nodes.messages import Array
from scenarios.setup import Setup

TOLERANCE = 1e-10
# What is zero up to rounding has the scale of its neighbours.
_LEAST = 1e-3


def departures(setup: Setup, trace: Trace) -> dict[str, tuple[np.ndarray, Array, Array]]:
    """Where the vectorised driver departs from a trace of the same run by more than that.

    Returns:
        By quantity, those that depart alone: where (index of the first, step first), the value of
        the trace there, and that of the vectorised driver.
    """
    histories = simulate(setup, [setup.scenario.run], keep=OPTIONAL)
    assert histories.readings is not None
    assert histories.cov is not None and histories.ages is not None
    receiver = np.repeat(np.arange(len(setup.neighbours)), [len(some) for some in setup.neighbours])
    sender = np.array([j for some in setup.neighbours for j in some], dtype=np.int64)
    sd = np.sqrt(np.abs(np.diagonal(trace.cov, axis1=-2, axis2=-1)))
    compared = {
        "truth": (trace.truth, histories.truth[0], np.abs(trace.truth)),
        "readings": (trace.readings, histories.readings[0], np.abs(trace.readings)),
        "payload_bytes": (trace.payload_bytes, histories.payload_bytes[0], _exact),
        "mean": (trace.mean, histories.mean[0], np.maximum(np.abs(trace.mean), sd)),
        "cov": (trace.cov, histories.cov[0], sd[..., :, None] * sd[..., None, :]),
        "ages": (trace.ages[:, receiver, sender], histories.ages[0], _exact),
    }
    found = {}
    for name, (expected, value, scale) in compared.items():
        departs = np.argwhere(_departs(expected, value, scale))
        if len(departs):
            where = tuple(departs[0])
            found[name] = (departs[0], expected[where], value[where])
    return found


_exact = np.zeros(())


def _departs(expected: Array, value: Array, scale: Array) -> np.ndarray:
    if scale is _exact:
        return expected != value
    limit = TOLERANCE * np.maximum(scale, _LEAST * np.nanmax(scale, initial=0.0))
    missing = np.isnan(expected)
    beyond = np.abs(np.where(missing, 0.0, value - expected)) > np.where(missing, 0.0, limit)
    return beyond | (missing != np.isnan(value))
