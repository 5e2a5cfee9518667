"""The pieces that a sweep is computed in: some runs of one cell, from a scenario to its figures."""

import hashlib
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import msgspec
import numpy as np

from concord.results.figures.figure_table import FIGURES, SWEPT, computed
from concord.results.figures.run_frame import frame_of
from concord.results.figures.run_view import RunView
from concord.results.folder import commit, versions
from concord.runtime.batched.build import without_array_form
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.user.faults import user_faults
from concord.studies.monte_carlo.moments import apart, merged, reduced
from concord.studies.monte_carlo.simulate import (
    AGES,
    INNOVATIONS,
    READINGS,
    runs_together,
    simulate,
)
from concord.studies.sweep.specification import Cell, Specification

# Estimates of a piece that are in memory at once: nodes x runs x steps. The filter that hears
# everything has a lane for each run alone, so that small pieces spend their time in numpy's calls.
LARGEST = 1_000_000
# So many times as many where moments are kept: their figures are made of a part at a time.
PARTS_OF_MOMENTS = 2
# The same where messages are passed one by one, which takes a hundred times as long.
LARGEST_OF_MESSAGES = 10_000
# Figures that a piece reduces to moments, by what the sweep keeps.
REDUCED = {
    "moments": SWEPT,
    "figures": tuple(name for name in SWEPT if "step" in FIGURES[name].dimensions),
    "histories": (),
}


class Piece(NamedTuple):
    """Runs `first` to before `last` of a cell, and what is kept of them; the scenario as JSON, to
    travel anywhere. `exact`: expectations over the noise, where the scenario has them."""

    cell: int
    scenario: bytes
    first: int
    last: int
    keep: str = "histories"
    exact: bool = False

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return self.last - self.first


class Origin(msgspec.Struct, frozen=True):
    """Origin of pieces: versions of the libraries, and the commit of concord."""

    versions: dict[str, str]
    commit: str | None


@cache
def program() -> Origin:
    """Return what computes pieces here."""
    return Origin(versions(), commit())


def digest_of(piece: Piece, digests: dict[str, str], by: Origin) -> str:
    """Return the digest of all that the figures of a piece follow from.

    `digests` are those of the files that the sweep's values come from. The cell's number is left
    out, so that another sweep finds the same runs of the same scenario.
    """
    used = {name: digest for name, digest in digests.items() if name.encode() in piece.scenario}
    kept = f"{piece.keep}, exact" if piece.exact else piece.keep
    content = (piece.scenario.decode(), piece.first, piece.last, kept, used, by)
    return hashlib.sha256(msgspec.json.encode(content, order="deterministic")).hexdigest()[:32]


def runs_at_once(scenario: Scenario, keep: str = "histories") -> int:
    """Return the number of runs that a piece has at most, by what the sweep keeps."""
    if without_array_form(scenario) is not None:
        return max(1, LARGEST_OF_MESSAGES // (scenario.nodes * scenario.steps))
    largest = LARGEST * PARTS_OF_MOMENTS if keep == "moments" else LARGEST
    runs = max(1, largest // (scenario.nodes * scenario.steps))
    # A remainder of few runs would cost nearly as many of numpy's calls as runs taken together.
    together = runs_together(scenario)
    return runs - runs % together if runs > together else runs


def pieces_of(specification: Specification, cells: Sequence[Cell]) -> list[Piece]:
    """All pieces of these cells. They depend on the cell alone, so that results do too.

    They begin at multiples of their size: a sweep of more runs finds the pieces of one of fewer.
    """
    pieces = []
    for cell in cells:
        at_once = runs_at_once(cell.scenario, specification.keep)
        text = msgspec.json.encode(cell.scenario)
        for first in range(0, specification.runs, at_once):
            last = min(first + at_once, specification.runs)
            pieces.append(
                Piece(cell.number, text, first, last, specification.keep, specification.exact)
            )
    return pieces


@user_faults()
def compute(piece: Piece) -> dict[str, np.ndarray]:
    """Return the figures of a piece (`figure_table.FIGURES`), reduced as far as it says."""
    setup = prepare(msgspec.json.decode(piece.scenario, type=Scenario))
    if piece.exact and (figures := _exactly(piece)) is not None:
        return reduced(figures, REDUCED[piece.keep]) if REDUCED[piece.keep] else figures
    # A log may have no truth; what its readings say of the filters is then the only judgement.
    of_log = definition_of(setup.scenario).all_steps is not None
    keep = (READINGS, AGES, *((INNOVATIONS,) if of_log else ()))
    runs = simulate(setup, range(piece.first, piece.last), keep=keep)
    frame = frame_of(runs)
    parts, names = CellParts(piece.first), REDUCED[piece.keep]
    at_once = runs_at_once(setup.scenario)
    for first in range(piece.first, piece.last, at_once):
        part = piece._replace(first=first, last=min(first + at_once, piece.last))
        place = slice(first - piece.first, part.last - piece.first)
        figures = computed(RunView(runs.of(place), frame.of(place)))
        parts.add(part, reduced(figures, names) if names else figures)
    return parts.figures()


def _exactly(piece: Piece) -> dict[str, np.ndarray] | None:
    """Return the exact figures of a piece; None where the scenario has none."""
    # Only here: a study of runs needs nothing of it.
    from concord.studies.exact.figures import exact_figures
    from concord.studies.exact.truth import NotExact

    try:
        return exact_figures(piece.scenario, piece.first, piece.last)
    except NotExact:
        return None


class CellParts:
    """The figures of the pieces of a cell, in any order; moments are merged in that of the runs,
    from run `first` on."""

    def __init__(self, first: int = 0) -> None:
        self.runs, self._merged_to = 0, first
        self._moments: dict[str, np.ndarray] = {}
        self._waiting: dict[int, tuple[int, dict[str, np.ndarray]]] = {}
        self._others: dict[int, dict[str, np.ndarray]] = {}

    def add(self, piece: Piece, figures: dict[str, np.ndarray]) -> None:
        """Take those of a piece."""
        self.runs += piece.runs
        moments, others = apart(figures)
        if others:
            self._others[piece.first] = others
        self._waiting[piece.first] = piece.last, moments
        while self._merged_to in self._waiting:
            self._merged_to, moments = self._waiting.pop(self._merged_to)
            self._moments = merged(self._moments, moments) if self._moments else moments

    def figures(self) -> dict[str, np.ndarray]:
        """Return the figures of all pieces."""
        return self._moments | joined([self._others[first] for first in sorted(self._others)])


def joined(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the figures of a cell from those of its pieces, in order of their runs."""
    if len(parts) <= 1:
        return dict(*parts)
    weights = np.array([len(part["rmse"]) for part in parts], dtype=float)
    whole = {}
    for name in parts[0]:
        each = [part[name] for part in parts]
        if "run" in FIGURES[name].dimensions:
            whole[name] = np.concatenate(each)
        else:
            # A bound is a root of covariances, whose expectation is over all runs.
            squares = np.tensordot(weights / weights.sum(), np.square(each), axes=1)
            whole[name] = np.sqrt(squares)
    return whole
