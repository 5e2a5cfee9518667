"""Where to put sensors so that their radios form one network."""

import numpy as np
from numpy.typing import NDArray

from concord.plants.checks import require_positive

ATTEMPTS = 10_000
# So many nodes speak at a time: all pairs of ten thousand would take a gigabyte.
TOGETHER = 64


def place_sensors(
    nodes: int, area_side_m: float = 1000.0, radio_range_m: float = 330.0
) -> NDArray[np.float64]:
    """Positions (nodes, 2) in m, uniform in a square, whose network of radio range is connected.

    They are those of the smallest seed s = 0, 1, ... for which
    `numpy.random.default_rng(s).uniform(0, area_side_m, (nodes, 2))` is connected.

    Raises:
        ValueError: for no nodes, lengths that are not positive, or if none of the first
            `ATTEMPTS` seeds is connected (few nodes on a large area).
    """
    if nodes < 1:
        raise ValueError(f"{nodes} sensors: at least 1 must be placed; ask for more nodes")
    require_positive(area_side_m=area_side_m, radio_range_m=radio_range_m)
    for seed in range(ATTEMPTS):
        positions = np.random.default_rng(seed).uniform(0, area_side_m, (nodes, 2))
        if _in_one_piece(positions, radio_range_m):
            return positions
    raise ValueError(
        f"{nodes} sensors on {area_side_m:g} m x {area_side_m:g} m with a radio range of "
        f"{radio_range_m:g} m: no placement of the first {ATTEMPTS} seeds is connected; "
        "raise the range, shrink the area or add nodes"
    )


def _in_one_piece(positions: NDArray[np.float64], radio_range_m: float) -> bool:
    """Return whether a message that starts at the first node reaches all others."""
    pending = np.ones(len(positions), dtype=bool)
    pending[0] = False
    front = positions[:1]
    while len(front) and pending.any():
        waiting = np.flatnonzero(pending)
        speaking, front = front[:TOGETHER], front[TOGETHER:]
        offset = positions[waiting, None] - speaking
        near = (offset * offset).sum(axis=-1) <= radio_range_m**2
        heard = waiting[near.any(axis=1)]
        pending[heard] = False
        front = np.concatenate((front, positions[heard]))
    return not pending.any()
