"""The pieces that a sweep is computed in: some runs of one cell, from a scenario to its figures."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from concord.experiments.monte_carlo.run_figures import FIGURES, figures_of
from concord.experiments.monte_carlo.run_frame import frame_of
from concord.experiments.monte_carlo.simulate import simulate
from concord.experiments.sweep.specification import Cell, Specification
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario

# Estimates of a piece that are in memory at once: nodes x runs x steps.
LARGEST = 500_000


class Piece(NamedTuple):
    """Runs `first` to before `last` of a cell; the scenario as JSON, to travel anywhere."""

    cell: int
    scenario: bytes
    first: int
    last: int


def runs_at_once(scenario: Scenario) -> int:
    """Return the number of runs that a piece has at most."""
    return max(1, LARGEST // (scenario.nodes * scenario.steps))


def pieces_of(specification: Specification, cells: Sequence[Cell]) -> list[Piece]:
    """All pieces of these cells. They depend on the cell alone, so that results do too."""
    pieces = []
    end = specification.first_run + specification.runs
    for cell in cells:
        at_once = runs_at_once(cell.scenario)
        text = msgspec.json.encode(cell.scenario)
        for first in range(specification.first_run, end, at_once):
            pieces.append(Piece(cell.number, text, first, min(first + at_once, end)))
    return pieces


def compute(piece: Piece) -> dict[str, np.ndarray]:
    """Return the figures of a piece (`run_figures.FIGURES`)."""
    setup = prepare(msgspec.json.decode(piece.scenario, type=Scenario))
    runs = range(piece.first, piece.last)
    histories = simulate(setup, runs)
    return figures_of(setup, histories, frame_of(setup, runs, histories))


def joined(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the figures of a cell from those of its pieces, in order of their runs."""
    if len(parts) == 1:
        return parts[0]
    weights = np.array([len(part["rmse"]) for part in parts], dtype=float)
    whole = {}
    for name, figure in FIGURES.items():
        each = [part[name] for part in parts]
        if "run" in figure.dimensions:
            whole[name] = np.concatenate(each)
        else:
            # A bound is a root of covariances, whose expectation is over all runs.
            squares = np.tensordot(weights / weights.sum(), np.square(each), axes=1)
            whole[name] = np.sqrt(squares)
    return whole
