"""Results of the candidates of a design: their figures run by run, and their standing."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from concord.results.figures.intervals import Interval, mean_t
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_with_known
from concord.scenarios.types.assignment import refuse_left
from concord.studies.design.space import Values
from concord.studies.design.target import DesignTarget, error_of
from concord.studies.memory import check_workers, needed_bytes
from concord.studies.sweep.cells import sorted_out
from concord.studies.sweep.pieces import Piece, compute
from concord.studies.sweep.specification import Cell, Value
from concord.studies.sweep.workers import Engine

Cost = Literal["bytes", "bus-time", "occupancy", "energy"]


class CostFigure(NamedTuple):
    """A cost: the figure of a run that it is the mean of, its heading, and its meaning."""

    figure: str
    heading: str
    meaning: str


COSTS: dict[Cost, CostFigure] = {
    "bytes": CostFigure("bytes_per_step", "B/step", "bytes on the bus per step"),
    "bus-time": CostFigure("bus_time_us", "us/step", "us of the bus per step"),
    "occupancy": CostFigure("published", "published", "share of the nodes that publish per cycle"),
    "energy": CostFigure("energy_per_step", "mJ/step", "mJ per step (first-order radio model)"),
}
# The kept histories of a run suffice for errors, costs and consistency.
_KEPT = ("rmse", "rmse_centralised", "anees", "bound_mean", "bus_load", "delay_us",
         *(cost.figure for cost in COSTS.values()))  # fmt: skip


# Runs of a candidate that are computed at once: few enough that all cores have some.
AT_ONCE = 25


class Candidate(NamedTuple):
    """Figures (R,) by name of the first R runs of a candidate; R may be 0. They are the same in all
    runs of an `exact` one."""

    cell: Cell
    figures: dict[str, np.ndarray]
    exact: bool = False

    @property
    def runs(self) -> int:
        """Return how many runs are known."""
        return len(self.figures.get("rmse", ()))

    def cost(self, cost: Cost) -> tuple[float, float]:
        """Return the cost to minimise, then bytes, which decide between equal candidates."""
        spared, sent = (self.figures[COSTS[one].figure].mean() for one in (cost, "bytes"))
        return float(spared), float(sent)

    def error(self, target: DesignTarget, confidence: float) -> Interval:
        """Return the error as the target measures it."""
        return error_of(target, self.figures, confidence)


class RefusedCandidate(msgspec.Struct, frozen=True):
    """A candidate that cannot run, and why."""

    values: Values
    reason: str


def candidates_of(
    settled: Values, wanted: Sequence[Values], first_number: int, workers: int
) -> tuple[list[Candidate], list[RefusedCandidate]]:
    """Return the candidates that can run, of which nothing is known yet, and those that cannot.

    Raises:
        ValueError: there is no such scenario, its data cannot be read, or the candidates that so
            many workers hold at once do not fit into the memory.
    """
    cells = []
    for number, values in enumerate(wanted, start=first_number):
        asked: dict[str, Any] = {**settled, **values}
        scenario, left = scenario_with_known(**asked)
        refuse_left(scenario, {name: value for name, value in left.items() if name in settled})
        cells.append(Cell(number, values, scenario))
    good, bad = sorted_out(cells, AT_ONCE)
    needs = [needed_bytes(cell.scenario, AT_ONCE) for cell in good]
    # A race gives each candidate many pieces of work.
    check_workers((need for need in needs for _ in range(workers)), workers)
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
    placements: Sequence[Value] = (),
    exact: bool = False,
) -> list[Candidate]:
    """Return the same candidates with so many runs each, from `first_run` on; `exact` as in a
    `Piece`.

    Run r has the same noise for every candidate, so that they are compared on what they share; and
    the same placement of sensors, one of `placements` after the other. `on_runs` is told how many
    runs are done.
    """
    pieces: list[Piece] = []
    places: list[np.ndarray] = []
    for place, one in enumerate(candidates):
        missing = np.arange(one.runs, runs if not (one.exact and one.runs) else one.runs)
        scenarios = placed(one.cell.scenario, placements)
        for turn, scenario in enumerate(scenarios):
            mine = missing[missing % len(scenarios) == turn]
            for first in range(0, len(mine), AT_ONCE):
                some = mine[first : first + AT_ONCE]
                start = first_run + int(some[0]) // max(1, len(placements))
                text = msgspec.json.encode(scenario)
                one_piece = Piece(len(pieces), text, start, start + len(some), exact=exact)
                pieces.append(one_piece)
                places.append(np.stack([np.full(len(some), place), some]))
    more: dict[int, list[tuple[np.ndarray, dict[str, np.ndarray]]]] = {}
    done = 0
    for number, figures in engine(compute, pieces):
        (place, *_), numbers = places[number]
        kept = _kept(candidates[place].cell, figures)
        more.setdefault(int(place), []).append((numbers, kept))
        done += len(numbers)
        on_runs(done)
    grown = list(candidates)
    for place, parts in more.items():
        # Whichever piece was ready first: a run keeps its place.
        order = np.argsort(np.concatenate([numbers for numbers, _ in parts]))
        new = {
            name: np.concatenate([kept[name] for _, kept in parts])[order] for name in parts[0][1]
        }
        known = grown[place].figures if grown[place].runs else {name: new[name][:0] for name in new}
        grown[place] = grown[place]._replace(
            figures={name: np.concatenate([known[name], new[name]]) for name in new}
        )
    return [_repeated(one, runs) if one.exact else one for one in grown]


def _repeated(one: Candidate, runs: int) -> Candidate:
    more = max(0, runs - one.runs)
    return one._replace(
        figures={
            name: np.append(known, known[:1].repeat(more)) for name, known in one.figures.items()
        }
    )


def placed(scenario: Scenario, placements: Sequence[Value]) -> list[Scenario]:
    """Return the scenario with the sensors at each of these placements; as it is for none."""
    return [scenario.with_known(placement=one)[0] for one in placements] or [scenario]


def costs_alike(cost: Cost, one: Candidate, other: Candidate) -> bool:
    """Return whether two candidates cost the same within the spread of their runs, in bytes too."""
    for figure in {COSTS[cost].figure, COSTS["bytes"].figure}:
        common = min(one.runs, other.runs)
        apart = mean_t(other.figures[figure][:common] - one.figures[figure][:common])
        if not apart.low <= 0 <= apart.high:
            return False
    return True


def _kept(cell: Cell, figures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    first = definition_of(cell.scenario).score.first_step
    bound = figures["bound"][min(first, len(figures["bound"]) - 1) :]
    runs = len(figures["rmse"])
    mean = np.full(runs, np.sqrt(np.mean(bound**2)))
    return {name: figures.get(name, mean) for name in _KEPT}
