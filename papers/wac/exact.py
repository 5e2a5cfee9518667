"""The rule of the consensus paper on its plants, exactly, without chance, over graphs and rounds.

Tests hold these covariances, and those of the other rules, against the digits of the study.
"""

from collections.abc import Callable

import numpy as np

from concord.features.control.cruise import cruise
from concord.features.control.motor import motor_position, motor_speed
from concord.features.control.pitch import pitch
from concord.features.control.suspension import suspension
from concord.papers.kit.side_by_side import side_by_side
from concord.plants.linear import LinearPlant
from concord.studies.exact.averaged_errors import figures_of, network_of, over_nodes, propagate
from concord.studies.exact.averaged_rules import RULES
from concord.topology.graphs import build_graph
from concord.topology.weights import metropolis

NODES = 8
PLANTS: dict[str, Callable[[], LinearPlant]] = {
    "cruise": cruise,
    "bus": suspension,
    "pitch": pitch,
    "speed": motor_speed,
    "position": motor_position,
}
GRAPHS = ("ring", "path", "geometric", "complete")
ROUNDS = (1, 2, 5, 10, 20)

# The study prints its geometric graph's second eigenvalue modulus, .743, and not the graph. This
# is the smallest seed of ours within .006 of that.
GEOMETRIC_SEED = 28

# The study does not print its horizon. All plants but the bus have settled long before this one;
# the bus has the printed digits from about 1350 to 1450 steps.
STEPS = 1400
RECORDED_EVERY = 50

Exact = dict[str, tuple[np.ndarray, np.ndarray]]
"""Per plant: relative RMSE, ANEES, lambda_max and disagreement of the network after STEPS, (graphs,
rounds, 4), and the largest lambda_max over the recorded steps, (graphs, rounds)."""


def measure(
    plants: dict[str, Callable[[], LinearPlant]] = PLANTS,
    rule: str = "wac",
    graphs: tuple[str, ...] = GRAPHS,
) -> Exact:
    """Propagate a rule's covariances over all plants, graphs and rounds."""
    weights = [metropolis(build_graph(name, NODES, GEOMETRIC_SEED)).toarray() for name in graphs]
    powers = [[np.linalg.matrix_power(one, count) for count in ROUNDS] for one in weights]
    jobs = [(make, rule, np.array(powers), STEPS) for make in plants.values()]
    found = side_by_side("exact covariances", _last_and_worst, jobs)
    return dict(zip(plants, found, strict=True))


def _last_and_worst(
    job: tuple[Callable[[], LinearPlant], str, np.ndarray, int],
) -> tuple[np.ndarray, np.ndarray]:
    make, rule, averaging, steps = job
    worst = np.zeros(averaging.shape[:-2])
    figures = None
    moments = propagate(network_of(make()), RULES[rule], averaging, steps)
    for step, now in enumerate(moments, start=1):
        if step % RECORDED_EVERY == 0 or step == steps:
            figures = over_nodes(figures_of(now))
            worst = np.maximum(worst, figures.lambda_max)
    assert figures is not None, "the last step is recorded"
    return np.stack(figures, axis=-1), worst
