"""The result of a design as one JSON file: everything that was tried, and what is recommended."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from concord.results.figures.intervals import Interval, positive_mean_t
from concord.results.folder import commit, versions
from concord.runtime.json_file import read_json
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.user.trust import remember, require_known
from concord.scenarios.warnings import warnings_of
from concord.studies.design.age_bound import bound_steps_of
from concord.studies.design.candidates import (
    COSTS,
    Candidate,
    Cost,
    RefusedCandidate,
    placed,
)
from concord.studies.design.information_age import InformationAge, worst_age
from concord.studies.design.search import Confirmed, Found, SearchTask, on_front
from concord.studies.design.space import Values
from concord.studies.design.target import DesignTarget, error_of
from concord.studies.sweep.specification import FIELDS, Value, shown


class Tried(msgspec.Struct, frozen=True):
    """A candidate: its open fields, its error as the target measures it, and what it costs.

    `error` and `anees` are [value, low, high] with 95 % intervals over `runs`, which are alike if
    it is `exact`; `front` says that no
    other is cheaper and better. `age_bound_steps` bounds the age of information of one on the
    front; None for no bound.
    """

    values: Values
    runs: int
    error: Interval
    anees: Interval
    costs: dict[Cost, float]
    front: bool
    age_bound_steps: int | None = None
    exact: bool = False


class PlacementError(msgspec.Struct, frozen=True):
    """The error with the sensors at one placement, with its 95 % interval."""

    placement: str
    error: Interval


class Attempt(msgspec.Struct, frozen=True):
    """A candidate on `runs` fresh runs: `meets` if the upper bound, at `confidence`, is within;
    `by_placement` where several placements were asked for; `warnings` as before a run; `age` of
    information where it is known. The candidate `instead_of` costs the same within the spread, or
    less; its age has no bound. An `exact` one needs no fresh runs."""

    values: Values
    runs: int
    error: Interval
    confidence: float
    meets: bool
    command: str
    by_placement: list[PlacementError] = []
    warnings: list[str] = []
    age: InformationAge | None = None
    instead_of: Values | None = None
    exact: bool = False


class Design(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a design: the target, every candidate tried, and the recommendation or None.

    `finished` is false if the search was interrupted.
    """

    scenario: str
    settled: Values
    seed: int
    target: DesignTarget
    unit: str
    minimise: Cost
    tried: list[Tried]
    refused: list[RefusedCandidate]
    attempts: list[Attempt]
    recommended: Attempt | None
    finished: bool
    versions: dict[str, str]
    commit: str | None


def design_of(task: SearchTask, found: Found, finished: bool) -> Design:
    """Return the result of a search."""
    settled, target, minimise = task.settled, task.target, task.cost
    scenario = found.candidates[0].cell.scenario
    line = {one.cell.number for one in on_front(target, minimise, found.candidates)}
    attempts = [_attempt(task, one) for one in found.confirmed]
    design = Design(
        scenario=scenario.name,
        settled=settled,
        seed=scenario.seed,
        target=target,
        unit=definition_of(scenario).score.unit,
        minimise=minimise,
        tried=[_tried(task, one, one.cell.number in line) for one in found.candidates],
        refused=found.refused,
        attempts=attempts,
        recommended=next((one for one in attempts if one.meets), None),
        finished=finished,
        versions=versions(),
        commit=commit(),
    )
    remember(design)
    return design


def check_place(path: Path) -> None:
    """Refuse a place that takes no file, before a search that is long; leaves its folder there.

    Raises:
        ValueError: naming the place and why.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(exist_ok=False)
        path.unlink()
    except OSError as error:
        raise ValueError(
            f"--out {path}: cannot be written ({error.strerror}); choose another place"
        ) from None


def read_design(path: Path) -> Design:
    """Read a design.

    Raises:
        ValueError: there is none, or it is not one of ours.
    """
    design = read_json(
        path,
        Design,
        "name a file that concord design has written",
        "not the result of `concord design`",
    )
    require_known(design, path)
    return design


def command_for(verb: str, values: Values, more: Sequence[str] = ()) -> str:
    """Return the command that runs these fields."""
    options = [_option(verb, field, values[field]) for field in FIELDS if field in values]
    return " ".join([f"concord {verb}", *options, *more])


def _option(verb: str, field: str, value: Value) -> str:
    name = field.replace("_", "-")
    if verb == "run" and isinstance(value, bool):
        return f"--{name}" if value else f"--no-{name}"
    return f"--{name} {str(value).lower() if isinstance(value, bool) else shown(value)}"


def nearest(design: Design) -> Tried:
    """Return the least error of all candidates, for a target that no candidate meets."""
    return min(design.tried, key=lambda one: (bool(np.isnan(one.error.value)), one.error.value))


def _tried(task: SearchTask, one: Candidate, front: bool) -> Tried:
    return Tried(
        values=one.cell.values,
        runs=one.runs,
        error=one.error(task.target, 0.95),
        anees=positive_mean_t(one.figures["anees"]),
        costs={cost: one.cost(cost)[0] for cost in COSTS},
        front=front,
        age_bound_steps=bound_steps_of(one, task.placements) if front else None,
        exact=one.exact,
    )


def _attempt(task: SearchTask, one: Confirmed) -> Attempt:
    values = {**task.settled, **one.candidate.cell.values}
    scenario = one.candidate.cell.scenario
    return Attempt(
        values=one.candidate.cell.values,
        runs=one.candidate.runs,
        error=one.error,
        confidence=one.confidence,
        meets=one.meets,
        command=command_for("run", values),
        by_placement=_by_placement(task, one.candidate),
        warnings=list(warnings_of(prepare(scenario))),
        age=worst_age(placed(scenario, task.placements)) if one.meets else None,
        instead_of=None if one.instead_of is None else one.instead_of.cell.values,
        exact=one.candidate.exact,
    )


def _by_placement(task: SearchTask, one: Candidate) -> list[PlacementError]:
    """Run r has placement r modulo their number."""
    of_each = [
        {name: values[place :: len(task.placements)] for name, values in one.figures.items()}
        for place in range(len(task.placements))
    ]
    return [
        PlacementError(shown(placement), error_of(task.target, figures, 0.95))
        for placement, figures in zip(task.placements, of_each, strict=True)
    ]
