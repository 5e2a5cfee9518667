"""Difference between the batched driver and a run that exchanged messages.

Sums in another order differ in their last bits, so equality here means equality to 1e-10 of the
scale. The scale of a mean is its size or its standard deviation. The scale of a covariance is the
product of its standard deviations. Both grow where a state is so far from zero that rounding of
doubles is more than that (`_distance`). A set may be as narrow as the rounding of its centre. The
scale of its shape is that product with one factor no smaller than the centre (`scale_of_cov`).

Sets that travel as float32 are first enlarged by half a unit of that number. A set that came so and
is sent on then lies between two such numbers, where the last bit of a sum chooses one of both.
Rounding of doubles chooses so for beliefs that are far from zero.
"""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.results.records.trace import Trace
from concord.scenarios.innovations import innovations_of_nodes
from concord.scenarios.rule_table.rules import is_set_valued, wire_number
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import OPTIONAL, simulate

_SUMS, _FLOAT32 = 1e-10, 1e-6
_DOUBLE = float(np.finfo(float).eps)
# A value that is zero up to rounding takes the scale of its neighbours.
_LEAST = 1e-3


def tolerance_of(setup: Setup, is_far: bool = False) -> float:
    """The part of the scale by which the batched driver may depart; `is_far` from zero."""
    scenario = setup.scenario
    is_coarse = wire_number(scenario) == "<f4" and (is_far or is_set_valued(scenario))
    return _FLOAT32 if is_coarse else _SUMS


def departures(setup: Setup, trace: Trace) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Where the batched driver departs from a trace of the same run by more than that.

    Returns:
        By quantity, those that depart alone: where (index of the first, step first), the value of
        the trace there, and that of the batched driver.
    """
    histories = simulate(setup, [setup.scenario.run], keep=OPTIONAL)
    assert histories.readings is not None
    assert histories.cov is not None and histories.ages is not None
    sd = np.sqrt(np.abs(np.diagonal(trace.cov, axis1=-2, axis2=-1)))
    distance = 1.0 if is_set_valued(setup.scenario) else _distance(trace.mean, sd)
    distance = np.broadcast_to(distance, (*trace.mean.shape[:-1], 1))
    tolerance = tolerance_of(setup, bool((distance > 1).any()))
    compared = {
        "truth": (trace.truth, histories.truth[0], np.abs(trace.truth)),
        "readings": (trace.readings, histories.readings[0], np.abs(trace.readings)),
        "payload_bytes": (trace.payload_bytes, histories.payload_bytes[0], _exact),
        "classes": (trace.classes, histories.classes[0], _exact),
        "mean": (trace.mean, histories.mean[0], scale_of_mean(setup, trace.mean, sd)),
        "cov": (trace.cov, histories.cov[0], scale_of_cov(setup, trace.mean, sd)),
        "ages": (trace.ages[:, *setup.links], histories.ages[0], _exact),
    }
    if trace.extra is not None and histories.extras:
        both = (one.digest_numbers() for one in (trace.extra, histories.extras[0]))
        compared["tracks"] = (*both, _exact)
    if trace.suspect is not None and histories.suspect is not None:
        compared["suspect"] = (trace.suspect, histories.suspect[0], _exact)
    if trace.past is not None and histories.past is not None:
        compared["smoothed"] = (trace.past.mean, histories.past.mean[0], trace.past.std)
    own = innovations_of_nodes(
        setup,
        [setup.scenario.run],
        Gaussian(trace.mean[None], trace.cov[None]),
        trace.readings[None],
        None if trace.control is None else trace.control[None],
    )
    if own is not None and histories.innovations is not None:
        std = np.sqrt(np.abs(np.diagonal(own.cov[0], axis1=-2, axis2=-1)))
        far = distance[..., None]
        scale = far * np.maximum(np.abs(own.value[0]), np.nan_to_num(std))
        compared["innovation"] = (own.value[0], histories.innovations.value[0], scale)
        scale = far[..., None] * std[..., :, None] * std[..., None, :]
        compared["innovation_cov"] = (own.cov[0], histories.innovations.cov[0], scale)
    found = {}
    for name, (expected, value, scale) in compared.items():
        departs = np.argwhere(_departs(expected, value, scale, tolerance))
        if len(departs):
            where = tuple(departs[0])
            found[name] = (departs[0], expected[where], value[where])
    if found.keys() & {"mean", "cov", "readings"}:
        # Innovations are computed from these, and follow them.
        for name in ("innovation", "innovation_cov"):
            found.pop(name, None)
    return found


def scale_of_mean(setup: Setup, mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Scale (..., n) of means, or of the centres of sets.

    An exact reading hands the rounding of its largest state to each state of a set.
    """
    if not is_set_valued(setup.scenario):
        return np.maximum(np.abs(mean), sd * _distance(mean, sd))
    scale = np.maximum(np.abs(mean), sd)
    return np.broadcast_to(scale.max(-1, keepdims=True), scale.shape)


def scale_of_cov(setup: Setup, mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Scale (..., n, n) of covariances with these standard deviations (..., n), or of shapes."""
    if not is_set_valued(setup.scenario):
        return _distance(mean, sd)[..., None] * sd[..., :, None] * sd[..., None, :]
    least = scale_of_mean(setup, mean, sd)
    one = sd[..., :, None] * least[..., None, :]
    return np.maximum(one, np.swapaxes(one, -1, -2))


def _distance(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """How often the rounding of the farthest state is that of sums, (..., 1); 1 near zero.

    Sigma points share the rounding of their centre, and hand it to all states.
    """
    away = np.abs(mean) / np.where(sd > 0, sd, np.inf)
    return np.maximum(1.0, _DOUBLE / _SUMS * away.max(axis=-1, keepdims=True))


_exact = np.zeros(())


def _departs(
    expected: np.ndarray, value: np.ndarray, scale: np.ndarray, tolerance: float
) -> np.ndarray:
    if scale is _exact:
        return expected != value
    limit = tolerance * np.maximum(scale, _LEAST * np.nanmax(scale, initial=0.0))
    missing = np.isnan(expected)
    beyond = np.abs(np.where(missing, 0.0, value - expected)) > np.where(missing, 0.0, limit)
    return beyond | (missing != np.isnan(value))
