"""The verdict on runs: failures first, then what was recorded, then honesty."""

from collections.abc import Iterator
from math import ceil
from typing import NamedTuple

import msgspec
import numpy as np

from concord.filters.metrics import mean_of_known
from concord.results.figures.intervals import (
    BATCHES,
    Interval,
    batch_means,
    chi_square_quantile,
    positive_mean_t,
)
from concord.results.figures.network_errors import where_counted
from concord.results.figures.run_view import RunView
from concord.results.innovations.channel_test import LEAST_UPDATES
from concord.results.innovations.figures import (
    InnovationFigures,
    innovation_figures,
    nis_per_step,
    outside_model,
)
from concord.results.innovations.gates import accepted, refused_by_gates
from concord.results.verdict.failures import failures
from concord.results.verdict.findings import MARGIN, Finding, VerdictOnRuns, beyond, verdict_of
from concord.results.verdict.honesty import (
    ESTIMATES_CONFIDENCE,
    honesty,
    outside_in_words,
    times_claimed,
)
from concord.scenarios.catalogue import as_long_as, definition_of
from concord.scenarios.innovations import HearsAll, Innovations
from concord.scenarios.scenario_definition import Explanation
from concord.scenarios.setup import Setup

_TAIL = 0.999
_LATE_SHARE = 0.01
"""In real time such a part of the frames may come late without a word."""
_HEAVY = 10.0
"""So many times the expected share of estimates beyond the quantile `_TAIL` is no chance."""


class Judged(NamedTuple):
    """The verdict, and the figures of innovations; None where estimates are sets, or sensors have
    no filter."""

    verdict: VerdictOnRuns
    innovations: InnovationFigures | None


def judge(view: RunView, heard: HearsAll | None) -> Judged:
    """Judge runs; `heard` is the filter that hears everything with its innovations, None where the
    runs have none of their own."""
    own = view.runs.innovations
    if own is None or heard is None:
        findings = [*failures(view), *_recorded(view)]
        if not any(one.level == "FAILED" for one in findings):
            findings += _without_innovations(view)
        return Judged(verdict_of(findings), None)
    inside = view.counted & ~outside_model(view.setup, heard.belief, view.counted).steps
    findings = [*failures(view, refused_by_gates(view.setup, own, inside)), *_recorded(view)]
    has_failed = any(one.level == "FAILED" for one in findings)
    nees = where_counted(view.counted, mean_of_known(view.errors.nees, (2,)))
    best = where_counted(view.counted, view.errors.nees_centre)
    figures, honest = judged_innovations(
        view.setup, own, heard, view.counted, nees, _enough(view), not has_failed, best
    )
    if not has_failed:
        # The tails say more than a mean which a few runs decide.
        findings += [*_tails(view), honest]
    return Judged(verdict_of(findings), figures)


def judged_innovations(
    setup: Setup,
    own: Innovations,
    heard: HearsAll,
    counted: np.ndarray,
    nees: np.ndarray,
    enough: str = "more --steps",
    explain: bool = True,
    nees_centre: np.ndarray | None = None,
) -> tuple[InnovationFigures, Finding]:
    """Return the figures of innovations (R, S, N, r, m), and the finding on honesty.

    Args:
        setup: of the runs.
        own, heard: of the nodes' own readings, and of the filter that hears everything.
        counted: (R, S), the steps that count. Those for which the model does not hold do not.
        nees: (R, S), mean of the nodes' normalised errors squared per state; NaN for unknown.
        enough: the options of a run that is long enough to judge.
        explain: whether to ask the plant's own data, which takes seconds.
        nees_centre: as `nees`, of the filter that hears everything; None for unknown.
    """
    outside = outside_model(setup, heard.belief, counted)
    counted = counted & ~outside.steps
    mine, best = (
        one._replace(value=where_counted(counted, one.value), nis=where_counted(counted, one.nis))
        for one in (accepted(setup, own), accepted(setup, heard.innovations))
    )
    figures, diagnosis = innovation_figures(setup, mine, best, outside.shares)
    nis, anees = (_interval_of(one, ESTIMATES_CONFIDENCE) for one in (nis_per_step(mine), nees))
    told = definition_of(setup.scenario).explain if explain else lambda *_: Explanation()
    explained = told(setup, heard.belief, counted)
    unknown = np.full_like(nees, np.nan)
    best = _interval_of(unknown if nees_centre is None else nees_centre, ESTIMATES_CONFIDENCE)
    found = honesty(setup.scenario, diagnosis, nis, anees, explained, enough, best)
    said = found.said + outside_in_words(outside.shares)
    return figures, msgspec.structs.replace(found, said=said)


def anees_interval(view: RunView, confidence: float = 0.95) -> Interval:
    """Return the interval of ANEES: over runs, or over batches of steps of one run."""
    per_step = mean_of_known(view.errors.nees, (2,))
    return _interval_of(where_counted(view.counted, per_step), confidence)


def _interval_of(per_step: np.ndarray, confidence: float) -> Interval:
    """The interval of a mean over the runs and steps (R, S), over batches of steps for one run."""
    if len(per_step) == 1:
        return batch_means(per_step[0], confidence)
    return positive_mean_t(mean_of_known(per_step, (1,)), confidence)


def _recorded(view: RunView) -> Iterator[Finding]:
    steps, asked = view.runs.steps, view.setup.scenario.steps
    if steps < asked:
        yield Finding(
            level="CHECK",
            cause="incomplete",
            said=f"{steps} of {asked} steps were completed by all nodes",
            cure=f"run it again, or ask for --steps {steps}",
            count=steps,
        )
    late, heard = (int(np.sum(view.runs.counters.get(name, 0))) for name in ("late", "heard"))
    if view.runs.estimate_age_s is not None and late > _LATE_SHARE * (late + heard):
        yield Finding(
            level="CHECK",
            cause="late frames",
            said=f"{100 * late / (late + heard):.2g} % of the frames came after their cycle",
            cure="use a larger --cycle-stretch, or fewer nodes on this machine",
            count=late,
        )


def _enough(view: RunView) -> str:
    """The options of runs that are long enough, or so many that they can be judged."""
    if len(view.readings) > 1:
        return f"--runs {max(5, 4 * len(view.readings))}"
    counted = int(view.counted.sum(axis=1).max())
    first = view.runs.steps - counted
    taken = np.isfinite(view.readings).any(axis=(3, 4))
    most = int(where_counted(view.counted, taken.astype(float))[:, first:].sum(axis=(0, 1)).max())
    # Twice as many readings of the busiest node as a test needs, or twice as many as there were.
    least = max(2 * BATCHES, ceil(2 * LEAST_UPDATES * counted / most) if most else 0)
    enough = first + (least if counted < least else 2 * counted)
    return as_long_as(view.setup.scenario, enough)


def _tails(view: RunView) -> Iterator[Finding]:
    """Whether more estimates lie far out than a chi-square law lets, in most runs or in some."""
    nees, states = view.scored(view.errors.nees), len(view.score.nees_states)
    known = np.logical_not(np.isnan(nees))
    if len(nees) < 2 or not known.any():
        return
    limit = chi_square_quantile(_TAIL, states) / states
    share = mean_of_known(np.where(known, nees > limit, np.nan), (1, 2))
    middle = float(np.nanmedian(mean_of_known(nees, (1, 2))))
    far = float(np.nanmean(share))
    some = int((share > _HEAVY * (1 - _TAIL)).sum())
    mean = anees_interval(view)
    if middle <= MARGIN and some and far > _HEAVY * (1 - _TAIL) and mean.value > MARGIN:
        yield Finding(
            level="CHECK",
            cause="heavy tails",
            said=(
                f"in {some} of {len(share)} runs estimates are far out: {100 * far:.2g} % of all "
                f"lie beyond the 99.9 % quantile, though the median run has ANEES {middle:.3g}"
            ),
            cure=f"look at run {int(view.runs.runs[int(share.argmax())])} with --run",
            count=some,
        )


def _without_innovations(view: RunView) -> Iterator[Finding]:
    """Of sets, whether they hold the truth; else ANEES alone."""
    if view.sets is not None:
        found = view.sets[False]
        outside, sets = (int(one.sum()) for one in (found.outside((1, 2)), found.known))
        said = f"sets: {outside} of {sets} do not hold the truth"
        level = "CHECK" if outside else "WORKS"
        cause = "sets miss the truth" if outside else "consistent"
        yield Finding(level=level, cause=cause, said=said, count=outside)
        return
    anees = anees_interval(view, ESTIMATES_CONFIDENCE)
    if beyond(anees) == "overconfident":
        said = f"overconfident: ANEES is {anees.value:.3g} where 1 is right"
        yield Finding(level="CHECK", cause="overconfident", said=said)
    elif anees.value < 1 / MARGIN:
        said = f"cautious: nodes claim {times_claimed(anees.value)}"
        yield Finding(level="WORKS", cause="cautious", said=said)
    else:
        shown = "" if np.isnan(anees.value) else f" (ANEES {anees.value:.3g} where 1 is right)"
        yield Finding(level="WORKS", cause="consistent", said=f"consistent: nothing failed{shown}")
