"""The innovations of one run: variables of run.nc, figures, a table, and the verdict on them."""

from typing import Any, NamedTuple

import msgspec
import numpy as np
from rich import box
from rich.table import Table

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import mean_of_known
from concord.results.figures.intervals import Interval, positive_mean_t
from concord.results.figures.network_errors import where_counted
from concord.results.innovations.figures import (
    ChannelFigures,
    InnovationFigures,
    NisFigures,
    accepted,
    innovation_figures,
    nis_per_step,
    outside_model,
)
from concord.results.innovations.sentence import (
    ESTIMATES_CONFIDENCE,
    innovation_verdict,
    outside_in_words,
)
from concord.results.records.trace import Trace
from concord.results.run_verdict import anees_interval
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import (
    HearsAll,
    Innovations,
    innovations_of_all,
    innovations_of_nodes,
)
from concord.scenarios.setup import Setup


class RunInnovations(NamedTuple):
    """Innovations of S steps of one run, with a leading axis of 1 for the run: of the nodes' own
    readings (1, S, N, r, m), and the filter that hears everything."""

    own: Innovations
    heard: HearsAll


def run_innovations(setup: Setup, trace: Trace) -> RunInnovations | None:
    """The innovations of a trace; None where estimates are sets, or sensors have no filter."""
    runs, readings = [setup.scenario.run], trace.readings[None]
    control = None if trace.control is None else trace.control[None]
    belief = Gaussian(trace.mean[None], trace.cov[None])
    own = innovations_of_nodes(setup, runs, belief, readings, control)
    heard = innovations_of_all(setup, runs, readings, control)
    return None if own is None or heard is None else RunInnovations(own, heard)


def innovation_variables(setup: Setup, found: RunInnovations) -> dict[str, Any]:
    """The variables of run.nc."""
    every = np.ones(found.heard.belief.mean.shape[:2], dtype=bool)
    outside = outside_model(setup, found.heard.belief, every)
    mask = {"outside_model": (("step",), outside.steps[0].astype(np.int8))}
    return {
        **({} if outside.shares is None else mask),
        **variables_of(Innovations(*(values[0] for values in found.own)), "", ("step",)),
        **variables_of(
            Innovations(*(values[0] for values in found.heard.innovations)),
            "centralised_",
            ("step",),
        ),
    }


def variables_of(innovations: Innovations, prefix: str, before: tuple[str, ...]) -> dict[str, Any]:
    """Innovations as variables of run.nc, with the axes `before` that of the nodes."""
    axes = (*before, "node", "reading")
    return {
        f"{prefix}innovation": ((*axes, "entry"), innovations.value),
        f"{prefix}innovation_cov": ((*axes, "entry", "other_entry"), innovations.cov),
        f"{prefix}nis": (axes, innovations.nis),
    }


def judged(
    setup: Setup, own: Innovations, heard: HearsAll, counted: np.ndarray, nees: np.ndarray
) -> tuple[InnovationFigures, str]:
    """The figures of innovations (R, S, N, r, m) in the steps that count (R, S), and the verdict.

    Steps for which the model does not hold do not count.
    `nees` (R, S) is the mean of the nodes' normalised errors squared in each step, per state; NaN
    where it is not known, or the model does not hold.
    """
    outside = outside_model(setup, heard.belief, counted)
    counted = counted & ~outside.steps
    own, all_ = (
        Innovations(*(where_counted(counted, part) for part in accepted(setup, one)))
        for one in (own, heard.innovations)
    )
    figures, diagnosis = innovation_figures(setup, own, all_)
    figures = msgspec.structs.replace(figures, outside=outside.shares)
    nis, anees = (_interval_of(found, ESTIMATES_CONFIDENCE) for found in (nis_per_step(own), nees))
    suspicion = _interval_of(nees, 0.95)
    explained = definition_of(setup.scenario).explain(setup, heard.belief, counted)
    sentence = innovation_verdict(setup.scenario, diagnosis, nis, anees, suspicion, explained)
    return figures, sentence + outside_in_words(outside.shares)


def judged_run(
    setup: Setup, found: RunInnovations | None, first: int, nees: np.ndarray
) -> tuple[InnovationFigures | None, str | None]:
    """`judged` of one run from step `first` on, with the NEES (S - first,) of each step."""
    if found is None:
        return None, None
    counted = np.arange(first + len(nees))[None] >= first
    nees = np.concatenate([np.full(first, np.nan), nees])[None]
    return judged(setup, found.own, found.heard, counted, nees)


def _interval_of(per_step: np.ndarray, confidence: float) -> Interval:
    """The interval of a mean over the runs and steps (R, S), over batches of steps for one run."""
    if len(per_step) == 1:
        return anees_interval(per_step[0], confidence)
    return positive_mean_t(mean_of_known(per_step, (1,)), confidence)


def nis_columns(figures: NisFigures) -> tuple[str, str, str]:
    """NIS, its interval, and the number of readings as cells of a table."""
    interval = figures.interval
    shown = "-" if interval is None else f"{interval[0]:.2g} to {interval[1]:.2g}"
    return short(figures.nis), shown, str(figures.updates)


def channel_table(figures: InnovationFigures) -> Table:
    """One row per channel, as the filter that hears everything sees it."""
    title = "innovations of the filter that hears everything"
    grid = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    grid.add_column("channel", no_wrap=True)
    for heading in ("taken", "NIS", "mean, 95 %", "lag 1"):
        grid.add_column(heading, justify="right", no_wrap=True)
    for one in figures.channels:
        grid.add_row(
            f"{one.node}: {one.name}{f' [{one.unit}]' if one.unit else ''}",
            str(one.updates), short(one.nis), _mean(one),
            "-" if one.correlation is None else f"{one.correlation:.2f}",
        )  # fmt: skip
    return grid


def _mean(one: ChannelFigures) -> str:
    if one.mean_interval is None:
        return _two(one.mean)
    return f"{_two(one.mean)} ± {(one.mean_interval[1] - one.mean_interval[0]) / 2:.2g}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def short(value: float | None) -> str:
    """A figure, or a dash."""
    return "-" if value is None or np.isnan(value) else f"{value:.3g}"
