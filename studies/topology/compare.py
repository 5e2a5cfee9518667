"""Graphs and weights side by side; families that are drawn at random with intervals over seeds."""

import dataclasses
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from concord.results.figures.intervals import Interval, positive_mean_t
from concord.studies.topology.convergence import predicted_factor
from concord.studies.topology.subject import Subject, SubjectOptions, subject_of
from concord.topology.adjacency import nodes_of
from concord.topology.analysis import analyse, rounds_to
from concord.topology.graphs import is_random


class GraphSpread(msgspec.Struct, frozen=True):
    """The mean over graphs and its 95 % interval (Student's t on the logarithm, as no figure is
    negative); both ends equal for one graph. None where some graph has no such figure."""

    mean: float | None
    low: float | None
    high: float | None

    def text(self) -> str:
        """For a table."""
        if self.mean is None or self.low is None or self.high is None:
            return "-"
        spread = Interval(self.mean, self.low, self.high).spread("± ")
        return f"{self.mean:.4g} {spread}" if self.high > self.low else f"{self.mean:.4g}"


class ComparisonRow(msgspec.Struct, frozen=True):
    """Figures of one graph, or over several of one random family."""

    graph: str
    weights: str
    links: str
    graphs: int
    nodes: int
    degree: GraphSpread
    diameter: GraphSpread
    cut_nodes: GraphSpread
    gap: GraphSpread
    factor: GraphSpread
    rounds_to_one_percent: GraphSpread


def compared(
    sources: list[str],
    options: SubjectOptions,
    by_weights: Sequence[str | None],
    seeds: int,
    on_row: Callable[[int], None],
) -> tuple[list[ComparisonRow], list[str]]:
    """A row for each graph and each weights, and how files were read where a user must know.

    Raises:
        ValueError: anything that cannot be, the graph and weights named.
    """
    # All are made before any is analysed: what cannot be is said at once.
    families = [
        _family(source, dataclasses.replace(options, weights=weights), seeds)
        for source in sources
        for weights in by_weights
    ]
    rows: list[ComparisonRow] = []
    for family in families:
        rows.append(_row(family))
        on_row(len(rows))
    told = [note for family in families for one in family for note in one.network.notes]
    return rows, list(dict.fromkeys(told))


def _family(source: str, options: SubjectOptions, seeds: int) -> list[Subject]:
    """Return the graph of each seed; one where the seed decides nothing."""
    drawn = seeds if is_random(source) else 1
    try:
        return [
            subject_of(source, dataclasses.replace(options, seed=seed), connected=True)
            for seed in range(options.seed, options.seed + drawn)
        ]
    except ValueError as error:
        raise ValueError(f"graph {source}: {error}") from None


def _row(family: list[Subject]) -> ComparisonRow:
    figures: list[tuple[float | None, ...]] = []
    for subject in family:
        a = analyse(subject.network.adjacency, subject.weights)
        _, factor = predicted_factor(subject)
        rounds = None if factor is None else rounds_to(0.01, factor)
        gap = 1 - a.second_eigenvalue_modulus
        figures.append((a.degree_mean, a.diameter, len(a.cut_nodes), gap, factor, rounds))
    spreads = [_spread(column) for column in zip(*figures, strict=True)]
    first = family[0]
    nodes = nodes_of(first.weights)
    return ComparisonRow(first.name, first.weights_name, first.links, len(family), nodes, *spreads)


def _spread(values: tuple[float | None, ...]) -> GraphSpread:
    known = np.array([value for value in values if value is not None], dtype=float)
    if len(known) < len(values):
        return GraphSpread(None, None, None)
    mean, low, high = positive_mean_t(known)
    return GraphSpread(mean, mean, mean) if len(known) == 1 else GraphSpread(mean, low, high)
