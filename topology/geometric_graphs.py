"""Graphs of radio range: a node hears the nodes within range."""

import math

import numpy as np
from scipy.spatial import KDTree

from concord.topology.adjacency import (
    Adjacency,
    both_ways,
    first_accepted,
    is_connected,
    require_nodes,
)


def geometric(positions: np.ndarray, radius: float) -> Adjacency:
    """Nodes at `positions` (n, d) hear each other up to and including the distance `radius`.

    Connectedness is not promised: it depends on the positions.

    Raises:
        ValueError: if the positions are not a finite (n, d) array or the radius is not positive.
    """
    positions = np.asarray(positions, dtype=float)
    if positions.ndim != 2 or not len(positions) or not np.isfinite(positions).all():
        raise ValueError(
            f"geometric graph: positions must be finite with one row per node, "
            f"but have shape {positions.shape}; give a finite array (nodes, 2)"
        )
    if not 0 < radius < math.inf:
        raise ValueError(
            f"geometric graph: radius {radius} must be above 0 and finite; give the radio range"
        )
    one, other = KDTree(positions).query_pairs(radius, output_type="ndarray").T
    return both_ways(len(positions), one, other)


def scatter(nodes: int, seed: int, radius: float | None = None) -> np.ndarray:
    """Uniform positions (nodes, 2) in the unit square, given that their graph is connected.

    `radius` is `connecting_radius(nodes)` unless given.

    Raises:
        ValueError: if no draw was connected, which a larger radius cures.
    """
    require_nodes(nodes, "geometric graph")
    reach = connecting_radius(nodes) if radius is None else radius
    return first_accepted(
        lambda generator: generator.uniform(size=(nodes, 2)),
        lambda positions: is_connected(geometric(positions, reach)),
        seed,
        f"geometric graph of {nodes} nodes with radius {reach:g} in the unit square",
    )


def connecting_radius(nodes: int) -> float:
    """Radius at which uniform points in the unit square hear about 2 ln n others each: twice the
    mean degree at the threshold of connectedness (Gupta and Kumar 1998, theorem 2.1)."""
    return math.sqrt(2 * math.log(max(nodes, 2)) / (math.pi * max(nodes, 2)))
