"""Report of `concord topology analyse` on a graph, in figures and in lines."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np

from concord.scenarios.observability import observability, rank, remaining
from concord.scenarios.setup import Setup
from concord.studies.topology.convergence import Convergence, convergence, random_links
from concord.studies.topology.subject import Subject
from concord.topology.adjacency import links_of, nodes_of
from concord.topology.analysis import Analysis, analyse, components, rounds_to
from concord.topology.convergence import cycle_factor, links_with, mean_square_factor
from concord.topology.network import part_of
from concord.topology.spectrum import second_eigenvalue_modulus
from concord.topology.weights import build_weights, masked

# Nodes are taken away one by one, which takes a second eigenvalue each: of small networks all are,
# of larger ones so many that some ten seconds pass.
MOST_LOSSES, _FEWEST_LOSSES = 150, 12
_LOSS_BUDGET = 200_000
_MOMENT_LOSSES = 60


class Seen(msgspec.Struct, frozen=True):
    """Observability of the plant by the nodes in `steps` steps.

    ranks: of n states, per node; remaining: what all readings together leave of the prior standard
    deviation of each state.
    """

    states: list[str]
    steps: int
    ranks: list[int]
    joint_rank: int
    blind: list[int]
    remaining: list[float]


class NodeLoss(msgspec.Struct, frozen=True):
    """Effect of losing a node: number of `pieces`, convergence factor per round, and growth of the
    remaining deviation of the most affected state.

    The factor is None if the network is no longer connected. For links with memory and for many
    nodes, it is that of the weights alone.
    """

    node: str
    pieces: int
    factor: float | None
    error_growth: float | None


class TopologyReport(msgspec.Struct, frozen=True):
    """A graph under weights and links; the worst loss first, of all nodes or of those of a large
    network that are likely to hurt most."""

    graph: str
    weights: str
    seed: int
    analysis: Analysis
    convergence: Convergence
    rounds_to_one_percent: int | None
    observability: Seen | None
    losses: list[NodeLoss]
    notes: list[str] = []
    """How the file of the graph was read, where a user must know."""


def report_of(
    subject: Subject, seed: int, on_node: Callable[[int], None] = lambda done: None
) -> TopologyReport:
    """All figures of a subject."""
    figures = analyse(subject.network.adjacency, subject.weights)
    found = convergence(subject, seed)
    factor = found.measured if found.predicted is None else found.predicted
    gramian = seen = None
    if subject.setup is not None:
        gramian, seen = _seen(subject.setup)
    return TopologyReport(
        subject.name,
        subject.weights_name,
        seed,
        figures,
        found,
        rounds_to(0.01, factor),
        seen,
        _losses(subject, suspects(subject, figures.cut_nodes, gramian), gramian, on_node),
        list(subject.network.notes),
    )


def _seen(setup: Setup) -> tuple[np.ndarray, Seen]:
    found = observability(setup)
    joint = found.gramian.sum(axis=0)
    return found.gramian, Seen(
        list(found.states),
        found.steps,
        [rank(own, joint) for own in found.gramian],
        rank(joint, joint),
        list(found.blind),
        remaining(joint).tolist(),
    )


def losses_of(nodes: int) -> int:
    """Return how many of so many nodes are taken away."""
    if nodes < 2:
        return 0
    return min(nodes, int(np.clip(_LOSS_BUDGET // nodes, _FEWEST_LOSSES, MOST_LOSSES)))


def suspects(subject: Subject, cut_nodes: Sequence[int], gramian: np.ndarray | None) -> list[int]:
    """The nodes to take away: all, or in turn a cut node, one that is heard by most, and one that
    sees most."""
    nodes = nodes_of(subject.weights)
    orders = [cut_nodes, np.argsort(-links_out(subject), kind="stable").tolist()]
    if gramian is not None:
        told = np.trace(gramian, axis1=-2, axis2=-1)
        orders.append(np.argsort(-told, kind="stable").tolist())
    turns = itertools.chain.from_iterable(itertools.zip_longest(*orders))
    unique = dict.fromkeys(node for node in turns if node is not None)
    return sorted(itertools.islice(unique, losses_of(nodes)))


def links_out(subject: Subject) -> np.ndarray:
    """Return how many hear each node (n,)."""
    _, heard = links_of(subject.network.adjacency)
    return np.bincount(heard, minlength=nodes_of(subject.weights))


def _losses(
    subject: Subject,
    chosen: Sequence[int],
    gramian: np.ndarray | None,
    on_node: Callable[[int], None],
) -> list[NodeLoss]:
    """The loss of each of these, the worst first: what falls apart, then what blinds, then what
    slows."""
    found = []
    for done, node in enumerate(chosen, 1):
        found.append(_without(subject, node, gramian))
        on_node(done)

    def badness(loss: NodeLoss) -> tuple[int, float, float]:
        # Rounding does not decide between equals: the first of them stays first.
        return (-loss.pieces, -round(loss.error_growth or 1.0, 6), -round(loss.factor or 0.0, 9))

    return sorted(found, key=badness)


def _without(subject: Subject, node: int, gramian: np.ndarray | None) -> NodeLoss:
    name = str(node) if subject.network.names is None else subject.network.names[node]
    kept = np.delete(np.arange(nodes_of(subject.weights)), node)
    rest = part_of(subject.network, kept)
    pieces = len(components(rest.adjacency))
    growth = None
    if gramian is not None:
        all_, without = gramian.sum(axis=0), gramian[kept].sum(axis=0)
        growth = float((remaining(without) / remaining(all_)).max())
    if pieces > 1:
        return NodeLoss(name, pieces, None, growth)
    weights = build_weights(subject.weights_name, rest.adjacency)
    if subject.phases:
        turns = [masked(weights, phase[kept][:, kept]) for phase in subject.phases]
        return NodeLoss(name, 1, cycle_factor(turns), growth)
    links = random_links(subject)
    if subject.plan.kind == "static" or links is None or len(kept) > _MOMENT_LOSSES:
        return NodeLoss(name, 1, second_eigenvalue_modulus(weights), growth)
    together = subject.plan.kind == "bernoulli"
    delivery = 1 - subject.plan.numbers[0] if together else rest.delivery
    assert delivery is not None
    factor = mean_square_factor(links_with(weights, delivery, together=together))
    return NodeLoss(name, 1, factor, growth)


def lines(report: TopologyReport) -> list[str]:
    """Return the report for people."""
    a, c = report.analysis, report.convergence
    kind = "directed links" if a.directed else "links"
    text = [
        f"{report.graph}: {a.nodes} nodes, {a.links} {kind}, weights {report.weights}, links "
        f"{c.links}, seed {report.seed}",
        *report.notes,
        _connection(a),
        f"degree {a.degree_min} to {a.degree_max}, {a.degree_mean:.3g} on average; diameter "
        + _diameter(a),
        f"cut nodes: {_some(a.cut_nodes)}; bridges: {_some(a.cut_links)}",
        f"weights alone: second eigenvalue modulus {a.second_eigenvalue_modulus:.6g}, spectral gap "
        f"{1 - a.second_eigenvalue_modulus:.4g}; a round leaves at most "
        f"{a.contraction_per_round:.4g} of a disagreement",
        *_convergence_lines(c),
        "rounds to 1 % of a disagreement: "
        + ("never" if report.rounds_to_one_percent is None else f"{report.rounds_to_one_percent}"),
    ]
    if (seen := report.observability) is not None:
        text += _seen_lines(seen)
    return text


def loss_title(report: TopologyReport) -> str:
    """Return the title of a report's losses."""
    losses, nodes = report.losses, report.analysis.nodes
    if len(losses) == nodes:
        return "what hurts most"
    seeing = ", see most" if report.observability is not None else ""
    return (
        f"what hurts most of {len(losses)} of {nodes} nodes (cut nodes, and those that most "
        f"hear{seeing}; the others were not taken away)"
    )


def _diameter(a: Analysis) -> str:
    if a.diameter_bounds is None:
        return "none"
    least, most = a.diameter_bounds
    if least == most:
        return f"{least} hops"
    return f"{least} to {most} hops (no more could be told in a few seconds)"


def _connection(a: Analysis) -> str:
    if len(a.components) == 1:
        return "strongly connected" if a.directed else "connected"
    pieces = f"not connected: {len(a.components)} parts"
    if not a.directed:
        return pieces
    if a.weak_components == 1:
        return f"{pieces}, joined only by links that go one way"
    return f"{pieces}, or {a.weak_components} if links that go one way count both ways"


def _convergence_lines(c: Convergence) -> list[str]:
    interval = f"95 % interval {c.measured_low:.6g} to {c.measured_high:.6g}"
    how = f"{c.rounds} rounds, {c.runs} runs; {interval}"
    measured = f"measured    {c.measured:.6g} per round ({how})"
    if c.rounds < c.rounds_to_settle:
        measured += f"; too early: {c.rounds_to_settle:,} rounds would leave the slowest mode alone"
    if c.predicted is None:
        return [f"predicted   none: {c.method}", measured]
    text = [f"predicted   {c.predicted:.6g} per round ({c.method})", measured]
    if c.difference_percent is not None:
        rate = c.rate_difference_percent
        also = "" if rate is None else f"; of the rates (logarithms) {rate:.2g} %"
        text.append(f"difference  {c.difference_percent:.2g} % of the factor{also}")
    return text


def _seen_lines(seen: Seen) -> list[str]:
    n = len(seen.states)
    alone = sum(r == n for r in seen.ranks)
    joint = "observable" if seen.joint_rank == n else f"NOT observable (rank {seen.joint_rank})"
    left = ", ".join(
        f"{name} {100 * part:.2g} %" for name, part in zip(seen.states, seen.remaining, strict=True)
    )
    return [
        f"plant, {seen.steps} steps: {joint} by all nodes together; {alone} of {len(seen.ranks)} "
        f"nodes see all {n} states alone; blind: {_some(seen.blind)}",
        f"all readings together leave of the prior deviation: {left}",
    ]


def _some(found: Any, most: int = 12) -> str:
    named = ["-".join(map(str, f)) if isinstance(f, tuple) else str(f) for f in found[:most]]
    more = f", ... ({len(found)})" if len(found) > most else ""
    return ", ".join(named) + more or "none"
