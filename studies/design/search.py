"""Search of a design: coarse grid, finer grid around the best, race, confirmation on fresh runs.

The race is successive halving on paired runs (Jamieson and Talwalkar 2016, Non-stochastic best arm
identification and hyperparameter optimization). Where they decide, intervals replace ranks. A
candidate leaves if it surely misses the target, or if it costs more than a candidate that surely
meets the target. The winner's figures are biased by its selection, so the promise uses fresh runs
only.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import islice
from typing import NamedTuple

import numpy as np

from concord.results.figures.intervals import Interval
from concord.scenarios.links import link_state
from concord.scenarios.preparation import prepare
from concord.studies.design.age_bound import bound_steps_of
from concord.studies.design.candidates import (
    Candidate,
    Cost,
    RefusedCandidate,
    candidates_of,
    costs_alike,
    with_runs,
)
from concord.studies.design.space import Values, coarse_grid, neighbours_of
from concord.studies.design.target import BusLimits, DesignTarget
from concord.studies.monte_carlo.pareto import front
from concord.studies.sweep.specification import Value
from concord.studies.sweep.workers import Engine

LOOK_RUNS = 4
RACE_RUNS = (8, 16, 32)
LOOKS_CLOSER = 6
CENTRES = 4
MOST_ON_FRONT = 8
ATTEMPTS = 4
# The first run of the confirmation: no search comes so far.
FRESH_RUN = 100_000


class SearchTask(NamedTuple):
    """Task of a search: target, limits, space, engine and its worker processes on this machine.

    `placements` of sensors are those that the network must bear: runs take one after the other.
    `say` receives the progress messages; `progress` shows how far the runs of a title are, of so
    many. With `exact`, candidates that have exact figures need no noise.
    """

    target: DesignTarget
    cost: Cost
    settled: Values
    space: Mapping[str, Sequence[Value]]
    confirm_runs: int
    engine: Engine
    workers: int
    say: Callable[[str], None]
    progress: Callable[[str, int], AbstractContextManager[Callable[[int], None]]] = (
        lambda _title, _total: nullcontext(lambda _done: None)
    )
    placements: tuple[Value, ...] = ()
    limits: BusLimits = BusLimits()
    exact: bool = False


class Confirmed(NamedTuple):
    """A candidate on runs that the search has not seen, and its error at that confidence.

    `instead_of` costs the same within the spread, or less; its age of information has no bound.
    """

    candidate: Candidate
    error: Interval
    confidence: float
    meets: bool
    instead_of: Candidate | None = None


class Found(NamedTuple):
    """State of a search: all candidates, the refused ones, and the confirmations in order."""

    candidates: list[Candidate]
    refused: list[RefusedCandidate]
    confirmed: list[Confirmed]

    @property
    def recommended(self) -> Confirmed | None:
        """Return the one that meets the target on fresh runs."""
        return next((one for one in self.confirmed if one.meets), None)


def search(task: SearchTask, kept: list[Candidate], refused: list[RefusedCandidate]) -> Found:
    """Search; `kept` and `refused` grow as it goes on, so that an interruption loses nothing.

    Raises:
        ValueError: none of the candidates can run.
    """
    _look(task, coarse_grid(task.settled, task.space), kept, refused)
    if not kept:
        raise ValueError(f"none of the candidates can run; the first: {refused[0].reason}")
    for _ in range(LOOKS_CLOSER):
        known = [one.cell.values for one in kept] + [one.values for one in refused]
        near = [
            values
            for centre in _centres(task, kept)
            for values in neighbours_of(task.settled, centre.cell.values, task.space)
        ]
        new: list[Values] = []
        for values in near:
            if values not in known and values not in new:
                new.append(values)
        if not new:
            break
        _look(task, new, kept, refused)
    finalists = _race(task, kept)
    return Found(kept, refused, _confirm(task, finalists))


def ranked(task_cost: Cost, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the cheapest first."""
    return sorted(candidates, key=lambda one: (*one.cost(task_cost), one.cell.number))


def on_front(target: DesignTarget, cost: Cost, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that no other beats in cost and error, the cheapest first."""
    by_cost = ranked(cost, candidates)
    # Rank in place of the cost: it knows which of two equal costs is dearer in bytes.
    errors = np.array([one.error(target, 0.95).value for one in by_cost])
    return [by_cost[place] for place in front(np.arange(len(by_cost), dtype=float), errors)]


def _look(
    task: SearchTask,
    wanted: Sequence[Values],
    kept: list[Candidate],
    refused: list[RefusedCandidate],
) -> None:
    new, bad = candidates_of(task.settled, wanted, len(kept) + len(refused), task.workers)
    refused += bad
    words = f", {LOOK_RUNS} runs each"
    if task.exact:
        new, words = _exact_of(new, task.placements)
    task.say(f"{len(new)} candidates{words}")
    for one in _with_runs(task, new, LOOK_RUNS):
        if (excess := task.limits.excess(one.figures)) is not None:
            refused.append(RefusedCandidate(one.cell.values, excess))
        elif np.isnan(one.cost(task.cost)[0]):
            why = f"--minimise {task.cost}: a bus without time has none; choose --minimise bytes"
            refused.append(RefusedCandidate(one.cell.values, why))
        else:
            kept.append(one)


def _exact_of(
    candidates: Sequence[Candidate], placements: Sequence[Value]
) -> tuple[list[Candidate], str]:
    """Return the candidates, told which are exact in all runs; and in words why others are not."""
    # Only here: a design by runs needs nothing of it.
    from concord.studies.exact.network import why_not

    setups = [prepare(one.cell.scenario) for one in candidates]
    found = [why_not(setup) for setup in setups]
    reasons = [reason for reason in found if reason is not None]
    words = f", {len(found) - len(reasons)} of them exactly, from second moments"
    if reasons:
        words += f"; {len(reasons)} by {LOOK_RUNS} runs each ({reasons[0]})"
    marked = [
        one._replace(exact=reason is None and not placements and link_state(setup).perfect)
        for one, reason, setup in zip(candidates, found, setups, strict=True)
    ]
    return marked, words


def _with_runs(
    task: SearchTask, candidates: Sequence[Candidate], runs: int, first_run: int = 0
) -> list[Candidate]:
    missing = sum(max(0, runs - one.runs) for one in candidates if not (one.exact and one.runs))
    with task.progress("runs", missing) as on_runs:
        return with_runs(
            candidates, runs, task.engine, on_runs, first_run, task.placements, task.exact
        )


def _centres(task: SearchTask, known: Sequence[Candidate]) -> list[Candidate]:
    """Around whom to look closer: the cheapest that seem to meet the target, and the best."""
    meets = [one for one in known if one.error(task.target, 0.95).value <= task.target.most]
    # Of equal costs the better one has more to give away.
    near = sorted(
        meets, key=lambda one: (one.cost(task.cost)[0], one.error(task.target, 0.95).value)
    )[: CENTRES - 1]
    best = min(known, key=lambda one: _comparable(one.error(task.target, 0.95).value))
    line = on_front(task.target, task.cost, known)
    missing = [one for one in line if one not in meets][-1:]
    return near + [one for one in (*missing, best) if one not in near]


def _race(task: SearchTask, known: list[Candidate]) -> list[Candidate]:
    """Runs for those that may still win; returns the finalists, the cheapest first."""
    racing = list(known)
    for runs in RACE_RUNS:
        racing = _still_in(task, racing)
        line = on_front(task.target, task.cost, known)[-MOST_ON_FRONT:]
        numbers = {one.cell.number for one in (*racing, *line)}
        places = [place for place, one in enumerate(known) if one.cell.number in numbers]
        if not all(known[place].exact for place in places):
            task.say(f"{len(places)} candidates, {runs} runs each")
        grown = _with_runs(task, [known[p] for p in places], runs)
        for place, one in zip(places, grown, strict=True):
            known[place] = one
        still = {one.cell.number for one in racing}
        racing = [one for one in grown if one.cell.number in still]
    meets = [one for one in racing if one.error(task.target, 0.95).value <= task.target.most]
    return ranked(task.cost, meets)


def _still_in(task: SearchTask, racing: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates that may be the cheapest to meet the target; at most half, rounded up."""
    target = task.target
    errors = {one.cell.number: one.error(target, 0.95) for one in racing}
    may = [one for one in racing if not errors[one.cell.number].low > target.most]
    sure = [one for one in may if errors[one.cell.number].high <= target.most]
    if sure:
        cheapest = ranked(task.cost, sure)[0]
        limit = cheapest.cost(task.cost)
        may = [
            one
            for one in may
            if one.cost(task.cost) <= limit or costs_alike(task.cost, cheapest, one)
        ]
    most = max((len(racing) + 1) // 2, 2 * MOST_ON_FRONT)
    # The cheap ones that seem to meet it come first, then the nearest misses.
    meets = [one for one in may if errors[one.cell.number].value <= target.most]
    misses = sorted(
        (one for one in may if one not in meets),
        key=lambda one: _comparable(errors[one.cell.number].value),
    )
    return [*ranked(task.cost, meets), *misses][:most]


def _confirm(task: SearchTask, finalists: Sequence[Candidate]) -> list[Confirmed]:
    """Return the cheapest finalists on fresh runs, until one meets the target; an exact one as it
    is.

    The upper bound is one-sided, and what may go wrong in all attempts together is 5 %: half of it
    for the first, a quarter for the second, and so on.
    """
    tried: list[Confirmed] = []
    chosen = islice(_bounded_first(task, finalists), ATTEMPTS)
    for attempt, (one, instead_of) in enumerate(chosen, start=1):
        risk = 0.05 / 2**attempt
        fresh = one
        if not one.exact:
            task.say(f"confirms {one.cell.name} on {task.confirm_runs} fresh runs")
            fresh = _with_runs(task, [one._replace(figures={})], task.confirm_runs, FRESH_RUN)[0]
        # A two-sided interval that leaves out `risk` above.
        error = fresh.error(task.target, 1 - 2 * risk)
        meets = error.high <= task.target.most and task.limits.excess(fresh.figures) is None
        tried.append(Confirmed(fresh, error, 1 - risk, meets, instead_of))
        if meets:
            break
    return tried


def _bounded_first(
    task: SearchTask, by_cost: Sequence[Candidate]
) -> Iterator[tuple[Candidate, Candidate | None]]:
    """Yield candidates, the cheapest first, and the one before which each is preferred.

    Of candidates that cost the same within the spread, one whose age of information has a bound is
    preferred.
    """
    left = list(by_cost)
    while left:
        place = next(
            (
                place
                for place, one in enumerate(left)
                if costs_alike(task.cost, left[0], one)
                and bound_steps_of(one, task.placements) is not None
            ),
            0,
        )
        yield left[place], left[0] if place else None
        del left[place]


def _comparable(value: float) -> float:
    return np.inf if np.isnan(value) else value
