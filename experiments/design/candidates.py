"""Results of the candidates of a design: their figures run by run, and their standing."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from concord.experiments.design.space import Values
from concord.experiments.design.target import DesignTarget, error_of
from concord.experiments.monte_carlo.intervals import Interval
from concord.experiments.scenario_options import scenario_with_known
from concord.experiments.sweep.cells import sorted_out
from concord.experiments.sweep.pieces import Piece, compute
from concord.experiments.sweep.specification import Cell
from concord.experiments.sweep.workers import Engine
from concord.scenarios.catalogue import definition_of
from concord.scenarios.types.assignment import refuse_left

Cost = Literal["occupancy", "bytes", "energy"]
_COSTS: dict[Cost, str] = {
    "occupancy": "published",
    "bytes": "bytes_per_step",
    "energy": "energy_per_step",
}
COST_UNITS: dict[Cost, str] = {
    "occupancy": "share of the nodes that publish per cycle",
    "bytes": "bytes on the bus per step",
    "energy": "mJ per step (first-order radio model)",
}
# The kept histories of a run suffice for errors, costs and consistency.
_KEPT = ("rmse", "rmse_centralised", "anees", *_COSTS.values())


# Runs of a candidate that are computed at once: few enough that all cores have some.
AT_ONCE = 25


class Candidate(NamedTuple):
    """Figures (R,) by name of the first R runs of a candidate; R may be 0."""

    cell: Cell
    figures: dict[str, np.ndarray]

    @property
    def runs(self) -> int:
        """Return how many runs are known."""
        return len(self.figures.get("rmse", ()))

    def cost(self, cost: Cost) -> tuple[float, float]:
        """Return the cost to minimise, then bytes, which decide between equal candidates."""
        spared, sent = (self.figures[name].mean() for name in (_COSTS[cost], "bytes_per_step"))
        return float(spared), float(sent)

    def error(self, target: DesignTarget, confidence: float) -> Interval:
        """Return the error as the target measures it."""
        return error_of(target, self.figures, confidence)


class RefusedCandidate(msgspec.Struct, frozen=True):
    """A candidate that cannot run, and why."""

    values: Values
    reason: str


def candidates_of(
    settled: Values, wanted: Sequence[Values], first_number: int
) -> tuple[list[Candidate], list[RefusedCandidate]]:
    """Return the candidates that can run, of which nothing is known yet, and those that cannot.

    Raises:
        ValueError: there is no such scenario, or its data cannot be read.
    """
    cells = []
    for number, values in enumerate(wanted, start=first_number):
        asked: dict[str, Any] = {**settled, **values}
        scenario, left = scenario_with_known(**asked)
        refuse_left(scenario, {name: value for name, value in left.items() if name in settled})
        cells.append(Cell(number, values, scenario))
    good, bad = sorted_out(cells, AT_ONCE)
    return (
        [Candidate(cell, {}) for cell in good],
        [RefusedCandidate(cell.values, str(reason)) for cell, reason in bad],
    )


def with_runs(
    candidates: Sequence[Candidate],
    runs: int,
    engine: Engine,
    on_runs: Callable[[int], None],
    first_run: int = 0,
) -> list[Candidate]:
    """Return the same candidates with so many runs each, from `first_run` on.

    Run r has the same noise for every candidate, so that they are compared on what they share.
    `on_runs` is told how many runs are done.
    """
    pieces = [
        Piece(place, msgspec.json.encode(one.cell.scenario), first, min(first + AT_ONCE, end))
        for place, one in enumerate(candidates)
        for end in [first_run + runs]
        for first in range(first_run + one.runs, end, AT_ONCE)
    ]
    more: dict[int, list[tuple[int, dict[str, np.ndarray]]]] = {}
    done = 0
    for number, figures in engine(compute, pieces):
        piece = pieces[number]
        kept = _kept(candidates[piece.cell].cell, figures)
        more.setdefault(piece.cell, []).append((piece.first, kept))
        done += piece.last - piece.first
        on_runs(done)
    grown = list(candidates)
    for place, parts in more.items():
        known = [grown[place].figures] if grown[place].runs else []
        # Whichever piece was ready first: a run keeps its place.
        known += [part for _, part in sorted(parts, key=lambda part: part[0])]
        grown[place] = grown[place]._replace(
            figures={name: np.concatenate([part[name] for part in known]) for name in known[0]}
        )
    return grown


def _kept(cell: Cell, figures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    first = definition_of(cell.scenario).score.first_step
    bound = figures["bound"][min(first, len(figures["bound"]) - 1) :]
    runs = len(figures["rmse"])
    mean = np.full(runs, np.sqrt(np.mean(bound**2)))
    return {**{name: figures[name] for name in _KEPT}, "bound_mean": mean}
