"""The figures of runs for people and programs: one form for one run and for many."""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from concord.results.bus import bus_report
from concord.results.figures.figure_table import FIGURES, RATIOS
from concord.results.figures.intervals import (
    METHODS,
    Interval,
    ratio_t,
    root_mean,
)
from concord.results.figures.run_frame import without_bound
from concord.results.figures.run_view import RunView
from concord.results.innovations.figures import InnovationFigures
from concord.results.outages import NodeOutage, outages_of
from concord.results.records import record_spread
from concord.results.records.extras import run_extras
from concord.results.records.runs import RunCost, Runs
from concord.results.verdict.findings import VerdictLevel, VerdictOnRuns, beyond
from concord.results.verdict.judge import anees_interval, judge
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.innovations import HearsAll, innovations_of_all

_TRAFFIC = ("sent", "heard", "missed")
_OF_NODES = {
    name: name.removesuffix("_node")
    for name, figure in FIGURES.items()
    if figure.dimensions == ("run", "node")
}
_OF_RUNS = tuple(name for name, figure in FIGURES.items() if figure.dimensions == ("run",))


class SmoothedFigure(msgspec.Struct, frozen=True):
    """RMSE of the states of `lag` steps ago, and beside a smoother that hears everything."""

    lag: int
    rmse: Interval
    to_centralised: Interval


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of R runs.

    Attributes:
        scenario, unit: its name, and the unit of errors.
        runs, first_run, steps: numbers of runs and steps. first_step: the first that counts, of the
            first run.
        verdict: its level, cause, sentence and findings.
        figures: by the names of `figure_table.FIGURES` and `RATIOS`, [value, low, high], with 95 %
            intervals over runs; of one run, over steps, and NaN where that is not known.
        nodes: the same of each node, by names without "_node".
        noticed: counters of the nodes, but traffic; per run.
        outages: which nodes were out, when, and whether that was asked for.
        warning: a run that decides the figures of all.
        innovations: None where estimates are sets, or sensors have no filter.
        details: of the bus, records, timing and more, where runs have them.
    """

    scenario: str
    unit: str
    runs: int
    first_run: int
    steps: int
    first_step: int
    verdict: VerdictOnRuns
    figures: dict[str, Interval]
    nodes: list[dict[str, Interval]]
    noticed: dict[str, float]
    outages: list[NodeOutage]
    warning: str | None
    innovations: InnovationFigures | None
    details: dict[str, Any]

    def value(self, name: str) -> float:
        """Return the value of a figure."""
        return self.figures[name].value

    def with_details(self, **details: Any) -> "Summary":
        """Return the figures with more details; what is None is left out."""
        more = {name: one for name, one in details.items() if one is not None}
        return msgspec.structs.replace(self, details=self.details | more)

    def as_json(self) -> bytes:
        """Return one JSON object; figures and details stand beside the other fields."""
        fields = msgspec.structs.asdict(self)
        figures, details = fields.pop("figures"), fields.pop("details")
        return msgspec.json.encode(fields | figures | details)


def heard_by_all(runs: Runs) -> HearsAll | None:
    """Return the filter that hears everything; None where the runs have no innovations."""
    if runs.innovations is None:
        return None
    assert runs.readings is not None, "keep the readings"
    numbers = runs.runs.tolist()
    return innovations_of_all(runs.setup, numbers, runs.readings, runs.control, runs.prior_mean)


def summarise(runs: Runs, cost: RunCost | None = None, heard: HearsAll | None = None) -> Summary:
    """Return the figures of runs with at least one complete step, which kept readings and ages.

    `heard` is the filter that hears everything, which is computed where it is not given.
    """
    setup, numbers = runs.setup, runs.runs.tolist()
    heard = heard or heard_by_all(runs)
    if heard is None:
        assert runs.readings is not None, "keep the readings"
        told = runs.readings, runs.control, runs.prior_mean
        belief = centralised_of_runs(setup, numbers, *told)
    else:
        belief = heard.belief
    view = RunView(runs, without_bound(belief))
    judged = judge(view, heard)
    values = {name: FIGURES[name].compute(view) for name in (*_OF_RUNS, *_OF_NODES)}
    figures = intervals_of(values, _OF_RUNS)
    if len(numbers) == 1:
        figures["anees"] = anees_interval(view)
    return Summary(
        scenario=setup.scenario.name,
        unit=view.score.unit,
        runs=len(numbers),
        first_run=numbers[0],
        steps=runs.steps,
        first_step=int(view.counted[0].argmax()),
        verdict=judged.verdict,
        figures=figures,
        nodes=[
            {
                short: interval_of(name, {name: values[name][:, node]})
                for name, short in _OF_NODES.items()
            }
            for node in range(setup.scenario.nodes)
        ],
        noticed=_noticed(runs),
        outages=outages_of(runs),
        warning=decisive_run(values["rmse"], numbers[0]),
        innovations=judged.innovations,
        details=_details(view, cost),
    )


def intervals_of(
    values: Mapping[str, np.ndarray], names: tuple[str, ...], method: str = "t"
) -> dict[str, Interval]:
    """Return figures (R,) with their intervals over runs, and ratios of which both are there."""
    there = {name: interval_of(name, values, method) for name in names if name in values}
    ratios = {
        name: interval_of(name, values, method)
        for name, ratio in RATIOS.items()
        if {ratio.one, ratio.other} <= values.keys()
    }
    return there | ratios


def interval_of(name: str, values: Mapping[str, np.ndarray], method: str = "t") -> Interval:
    """Return one figure or ratio of runs with its interval."""
    mean, ratio_of = METHODS[method]
    if (ratio := RATIOS.get(name)) is not None:
        return ratio_of(np.square(values[ratio.one]), np.square(values[ratio.other]))
    if FIGURES[name].statistic == "rms":
        return root_mean(values[name], ratio_of)
    return mean(values[name])


def level_of(figures: Mapping[str, Interval]) -> VerdictLevel:
    """Return FAILED where a run failed, CHECK where estimates claim too much, else WORKS."""
    if figures["failed"].value > 0:
        return "FAILED"
    doubtful = beyond(figures["anees"]) == "overconfident" or figures["sets_outside"].value > 0
    return "CHECK" if doubtful else "WORKS"


LEAST_RUNS = 5


def decisive_run(errors: np.ndarray, first_run: int = 0) -> str | None:
    """Return a sentence if one of the runs outweighs all others in their squared errors (R,).

    In such a run the target may have left all sensors, or a filter has lost it.
    """
    squares = np.nan_to_num(np.square(errors))
    if len(squares) < LEAST_RUNS or 2 * squares.max() <= squares.sum():
        return None
    run = first_run + int(squares.argmax())
    return (
        f"run {run} has more than half of the squared error of all {len(squares)} runs, so ratios "
        f"and intervals are mostly those of run {run}; look at it with --run {run}"
    )


def _noticed(runs: Runs) -> dict[str, float]:
    """Sums of the counters other than traffic, per run."""
    whole = {name: float(c.sum(axis=1).mean()) for name, c in sorted(runs.counters.items())}
    return {name: count for name, count in whole.items() if name not in _TRAFFIC and count}


def _details(view: RunView, cost: RunCost | None) -> dict[str, Any]:
    runs = view.runs
    found: dict[str, Any] = {}
    if view.smoothed is not None:
        network, central = view.smoothed
        pairs = enumerate(zip(network.T, central.T, strict=True))
        found["smoothed"] = [
            SmoothedFigure(lag, root_mean(mine), ratio_t(mine**2, best**2))
            for lag, (mine, best) in pairs
        ]
    if runs.suspect is not None:
        found["suspect"] = runs.suspect.sum(axis=1).mean(axis=0).tolist()
    if cost is not None:
        found |= cost._asdict()
        found["node_updates_per_second"] = runs.mean[..., 0].size / cost.seconds
    if len(runs.runs) > 1:
        return found
    if (bus := bus_report.figures_of(runs)) is not None:
        found["bus"] = bus
    if runs.spreads:
        found["spread"] = record_spread.figures_of(runs.spreads[0])
    if (extras := run_extras(view.setup.scenario)) is not None:
        found["tracking"] = extras.figures(view.setup, runs.extras[0], view.readings[0])
    return found
