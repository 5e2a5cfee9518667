"""Section 3.1 of the consensus study: the rules on the paper's plants, exactly, without chance.

`measure` propagates covariances over all plants, graphs and rounds; `checks_of` holds them against
the specification's digits and against what the rules promise.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.features.control.cruise import cruise
from concord.features.control.motor import motor_position, motor_speed
from concord.features.control.pitch import pitch
from concord.features.control.suspension import suspension
from concord.papers.kit.checks import Check, above, at_most, near
from concord.papers.kit.side_by_side import side_by_side
from concord.papers.wac.exact_covariance import figures_of, network_of, over_nodes, propagate
from concord.papers.wac.exact_rules import RULES
from concord.plants.linear import LinearPlant
from concord.topology.graphs import build_graph
from concord.topology.spectrum import second_eigenvalue_modulus
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
FUSED = ("wac", "ci", "hcmci", "icf")
CONSISTENT = ("wac", "ci", "hcmci")

# The specification prints its geometric graph's second eigenvalue modulus, .743, and not the graph.
# This is the smallest seed of ours within .006 of that.
GEOMETRIC_SEED = 28

# The specification does not print its horizon. All plants but the bus have settled long before
# this one; the bus has the printed digits from about 1350 to 1450 steps.
STEPS = 1400
SETTLED_STEPS = 6000
RECORDED_EVERY = 50


class Exact(NamedTuple):
    """Relative RMSE, ANEES, lambda_max and disagreement of the network, last axis (4,).

    after: per plant and rule, (graphs, rounds, 4) after STEPS.
    settled_bus: per rule, (rounds, 4) on the ring after SETTLED_STEPS.
    worst: per plant and rule, the largest lambda_max (graphs, rounds) over the recorded steps.
    alone: per plant, (4,) without any fusion. slem: per graph.
    """

    after: dict[str, dict[str, np.ndarray]]
    settled_bus: dict[str, np.ndarray]
    worst: dict[str, dict[str, np.ndarray]]
    alone: dict[str, np.ndarray]
    slem: dict[str, float]


def weights_of(graph: str) -> np.ndarray:
    """Metropolis weights (8, 8) of one of GRAPHS."""
    return metropolis(build_graph(graph, NODES, GEOMETRIC_SEED)).toarray()


def averagings(graphs: tuple[str, ...], rounds: tuple[int, ...]) -> np.ndarray:
    """Powers of their weights (graphs, rounds, 8, 8)."""
    return np.array(
        [[np.linalg.matrix_power(weights_of(name), count) for count in rounds] for name in graphs]
    )


def measure(plants: dict[str, Callable[[], LinearPlant]] = PLANTS) -> Exact:
    """Propagate everything."""
    everywhere = averagings(GRAPHS, ROUNDS)
    on_ring = averagings(("ring",), ROUNDS)[0]
    # (plant, rule, averaging, steps): each rule on each plant, each plant alone, then the bus.
    jobs = [
        *((make, rule, everywhere, STEPS) for make in plants.values() for rule in FUSED),
        *((make, "ci", np.eye(NODES), STEPS) for make in plants.values()),
        *((suspension, rule, on_ring, SETTLED_STEPS) for rule in FUSED),
    ]
    found = iter(side_by_side("exact covariances", _propagated, jobs))
    results = {name: {rule: next(found) for rule in FUSED} for name in plants}
    after = {name: {rule: last for rule, (last, _) in of.items()} for name, of in results.items()}
    worst = {name: {rule: most for rule, (_, most) in of.items()} for name, of in results.items()}
    alone = {name: next(found)[0] for name in plants}
    settled = {rule: next(found)[0] for rule in FUSED}
    slem = {name: second_eigenvalue_modulus(weights_of(name)) for name in GRAPHS}
    return Exact(after, settled, worst, alone, slem)


def _propagated(
    job: tuple[Callable[[], LinearPlant], str, np.ndarray, int],
) -> tuple[np.ndarray, np.ndarray]:
    make, rule, averaging, steps = job
    return _last_and_worst(network_of(make()), rule, averaging, steps)


def _last_and_worst(
    network, rule: str, averaging: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """The network's figures (..., 4) at the end, and the largest lambda_max (...) on the way."""
    worst = np.zeros(averaging.shape[:-2])
    figures = None
    for step, moments in enumerate(propagate(network, RULES[rule], averaging, steps), start=1):
        if step % RECORDED_EVERY == 0 or step == steps:
            figures = over_nodes(figures_of(moments))
            worst = np.maximum(worst, figures.lambda_max)
    assert figures is not None, "the last step is recorded"
    return np.stack(figures, axis=-1), worst


# --- the specification's digits ------------------------------------------------------------------

# Ring: relative RMSE / ANEES / lambda_max at 1, 5 and 20 rounds, for WAC, CI, HCMCI-safe and ICF.
PRINTED_ROUNDS = (1, 5, 20)
PRINTED_RING = {
    "cruise": (
        "1.31/.57/.59 1.29/.58/.59 1.11/.74/.76 1.10/1.21/1.39",
        "1.28/.56/.57 1.27/.57/.57 1.02/.80/.81 1.01/1.02/1.05",
        "1.28/.56/.56 1.27/.57/.57 1.00/.99/.99 1.00/1.00/1.00",
    ),
    "bus": (
        "1.40/.48/.83 1.32/.50/.82 1.08/.62/.88 1.04/1.04/1.62",
        "1.34/.49/.77 1.30/.49/.76 1.02/.75/.88 1.00/1.01/1.11",
        "1.33/.49/.76 1.30/.49/.75 1.00/.98/.99 1.00/1.00/1.00",
    ),
    "pitch": (
        "1.30/.46/.71 1.24/.47/.71 1.11/.66/.86 1.11/1.21/1.70",
        "1.25/.45/.67 1.21/.46/.67 1.02/.74/.85 1.01/1.02/1.11",
        "1.25/.45/.66 1.21/.46/.66 1.00/.98/.99 1.00/1.00/1.00",
    ),
    "speed": (
        "1.43/.71/.84 1.37/.71/.82 1.22/.87/.95 1.28/1.58/1.99",
        "1.39/.69/.76 1.33/.68/.74 1.04/.83/.89 1.03/1.07/1.21",
        "1.38/.68/.74 1.32/.67/.72 1.00/.99/.99 1.00/1.00/1.00",
    ),
    "position": (
        "1.49/.57/.89 1.37/.58/.88 1.18/.74/.97 1.20/1.36/1.98",
        "1.40/.56/.81 1.30/.55/.78 1.03/.76/.91 1.02/1.04/1.22",
        "1.39/.56/.79 1.30/.55/.76 1.00/.98/.99 1.00/1.00/1.00",
    ),
}
# Position, one round: relative RMSE / lambda_max / disagreement.
PRINTED_GRAPHS = {
    "ring": "1.49/.89/.34 1.37/.88/.34 1.18/.97/.48 1.20/1.98/.66",
    "path": "1.58/.95/.49 1.45/.94/.50 1.27/.95/.60 1.30/2.69/.79",
    "geometric": "1.49/.86/.29 1.34/.84/.27 1.09/.93/.31 1.09/2.03/.42",
    "complete": "1.39/.79/0 1.30/.76/0 1.00/1.00/0 1.00/1.00/0",
}
PRINTED_LARGEST = {"wac": 0.952, "ci": 0.941, "hcmci": 1.0, "icf": 3.80}
PRINTED_DISAGREEMENT = (0.335, 0.208, 0.089, 0.028, 0.003)  # CI, ring, position, by ROUNDS
PRINTED_SLEM = {"ring": 0.805, "path": 0.949, "complete": 0.0}
PRINTED_ALONE = {"cruise": 22.6, "bus": 216.0, "pitch": 232.0, "speed": 2.15, "position": 297.0}

RING_FIGURES = (0, 1, 2)
GRAPH_FIGURES = (0, 2, 3)
HALF_DIGIT = 0.005 + 1e-5  # of a figure with two decimals
# The study prints one disagreement as .335 and as .34: it rounds twice.
TWICE_ROUNDED = HALF_DIGIT + 5e-4


def printed(line: str) -> np.ndarray:
    """One printed line as (rules, 3)."""
    return np.array([[float(entry) for entry in cell.split("/")] for cell in line.split()])


def ring_table(exact: Exact, plant: str) -> np.ndarray:
    """Ours beside PRINTED_RING: (printed rounds, rules, 3)."""
    rows = [ROUNDS.index(count) for count in PRINTED_ROUNDS]
    return np.stack([exact.after[plant][rule][0][rows][:, RING_FIGURES] for rule in FUSED], axis=1)


def graph_row(exact: Exact, graph: str) -> np.ndarray:
    """Ours beside PRINTED_GRAPHS: (rules, 3)."""
    place = GRAPHS.index(graph)
    return np.stack([exact.after["position"][rule][place, 0, GRAPH_FIGURES] for rule in FUSED])


def largest(exact: Exact, rule: str, graphs: tuple[str, ...] = GRAPHS) -> float:
    """The largest lambda_max over plants, graphs and rounds at the end."""
    places = [GRAPHS.index(graph) for graph in graphs]
    return max(float(rules[rule][places, :, 2].max()) for rules in exact.after.values())


# --- judging -------------------------------------------------------------------------------------


def checks_of(exact: Exact) -> list[Check]:
    """The printed digits, and the promises of the rules."""
    return [*_digit_checks(exact), *_promise_checks(exact)]


def _digit_checks(exact: Exact) -> list[Check]:
    checks = []
    for plant in exact.after:
        wanted = np.stack([printed(line) for line in PRINTED_RING[plant]])
        gap = float(np.abs(ring_table(exact, plant) - wanted).max())
        name = f"exact, {plant}, ring: furthest of {wanted.size} cells from its printed digits"
        checks.append(at_most(name, gap, HALF_DIGIT))
    for graph in ("ring", "path", "complete"):
        gap = float(np.abs(graph_row(exact, graph) - printed(PRINTED_GRAPHS[graph])).max())
        name = f"exact, position, {graph}, 1 round: furthest of 12 cells from its printed digits"
        checks.append(at_most(name, gap, TWICE_ROUNDED))
    for graph, modulus in PRINTED_SLEM.items():
        checks.append(near(f"second eigenvalue modulus, {graph}", exact.slem[graph], modulus, 5e-4))
    fading = exact.after["position"]["ci"][0, :, 3]
    for count, ours, wanted in zip(ROUNDS, fading, PRINTED_DISAGREEMENT, strict=True):
        checks.append(near(f"disagreement, CI, ring, position, {count} rounds", ours, wanted, 6e-4))
    # The path is worst, and its graph is certain; the geometric one is another than printed.
    for rule, wanted in PRINTED_LARGEST.items():
        ours = largest(exact, rule, ("ring", "path", "complete"))
        checks.append(
            near(f"largest lambda_max but for the geometric graph, {rule}", ours, wanted, 6e-3)
        )
    return checks


def _promise_checks(exact: Exact) -> list[Check]:
    checks = []
    cells = len(exact.after) * len(GRAPHS) * len(ROUNDS)
    for rule in CONSISTENT:
        worst = max(float(rules[rule].max()) for rules in exact.worst.values())
        name = f"consistent: largest lambda_max of {rule}, {cells} networks, all recorded steps"
        checks.append(at_most(name, worst, 1 + 1e-6))
    for plant, rules in exact.after.items():
        for graph in ("ring", "path", "geometric"):
            value = rules["icf"][GRAPHS.index(graph), 0, 2]
            checks.append(above(f"overconfident: icf, {plant}, {graph}, 1 round", value, 1))
    for plant, rules in exact.after.items():
        complete = rules["icf"][GRAPHS.index("complete"), 0]
        away = float(np.abs(complete - [1, 1, 1, 0]).max())
        checks.append(at_most(f"icf on the complete graph is centralised, {plant}", away, 1e-6))
        alone = np.abs(exact.alone[plant][1:3] - 1).max()
        checks.append(at_most(f"alone: |ANEES - 1|, |lambda_max - 1|, {plant}", alone, 1e-6))
    return checks
