"""The estimate that a node sends to the environment at the end of a step."""

from functools import lru_cache
from typing import cast

import numpy as np

from concord.filters.linalg import pack_upper
from concord.nodes.estimator import (
    ChecksItself,
    KeepsPast,
    KeepsTracks,
    KeepsZonotope,
    SolvesProgrammes,
    WeighsShares,
)
from concord.nodes.messages import Estimate, to_wire
from concord.nodes.node_state import NodeConfig, NodeState

# The page shows two; a weight is not computed with.
_WEIGHT_DECIMALS = 4


def estimate_of(config: NodeConfig, state: NodeState) -> Estimate:
    """Return the belief of a step, and what else the node's rule knows."""
    estimator, content = config.estimator, state.content
    belief, ages = estimator.belief(content), estimator.ages(content)
    generators = smoothed = smoothed_std = None
    if _has(type(estimator), KeepsZonotope):
        generators = cast(KeepsZonotope, estimator).generators(content)
    if _has(type(estimator), KeepsPast):
        smoothed, cov = cast(KeepsPast, estimator).smoothed(content)
        smoothed_std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    checks = _has(type(estimator), ChecksItself)
    weights = tracks = gap = None
    if _has(type(estimator), SolvesProgrammes):
        gap = cast(SolvesProgrammes, estimator).gap(content)
    if _has(type(estimator), KeepsTracks):
        tracks = cast(KeepsTracks, estimator).tracks(content)
    if _has(type(estimator), WeighsShares):
        weights = cast(WeighsShares, estimator).weights(content)
    return Estimate(
        config.index,
        state.step,
        to_wire(belief.mean),
        to_wire(pack_upper(belief.cov)),
        ages.tolist(),
        state.counters,
        *(None if one is None else to_wire(one) for one in (generators, smoothed, smoothed_std)),
        suspect=checks and cast(ChecksItself, estimator).is_suspect(content),
        absent=tuple(sorted(state.absent)),
        weights=None if weights is None else to_wire(weights.round(_WEIGHT_DECIMALS)),
        tracks=tracks,
        gap=gap,
    )


@lru_cache
def _has(kind: type, protocol: type) -> bool:
    # Kept: to ask a protocol takes longer than to tell an estimate.
    return issubclass(kind, protocol)
