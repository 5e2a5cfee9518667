"""The standard-normal numbers that a plant consumes, drawn before it runs."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

GeneratorFor = Callable[[str, int], np.random.Generator]
"""The stream of a purpose ("initial", "process", "measurement") and a node."""


class Draws(NamedTuple):
    """One run's noise in units of its standard deviation."""

    initial: np.ndarray  # (p,)
    process: np.ndarray  # (steps, q)
    measurement: np.ndarray  # (steps, nodes, readings, d)


def standard_draws(
    generator_for: GeneratorFor,
    initial: int,
    process: int,
    measurement: tuple[int, int, int],
    steps: int,
) -> Draws:
    """Draws of the sizes p, q and (nodes, readings, d).

    Every node has a stream of its own and steps come one after the other, so a node's noise depends
    neither on the number of nodes nor on the number of steps.
    """
    nodes, readings, d = measurement
    of_nodes = np.empty((nodes, steps, readings, d))
    for node, noise in enumerate(of_nodes):
        generator_for("measurement", node).standard_normal(out=noise)
    return Draws(
        initial=generator_for("initial", 0).standard_normal(initial),
        process=generator_for("process", 0).standard_normal((steps, process)),
        measurement=of_nodes.swapaxes(0, 1),
    )
