"""The figures of many runs: each with its interval over the runs, which alone are independent."""

import msgspec
import numpy as np
from rich.table import Table

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import largest_of_known, mean_of_known, rmse
from concord.results.figures.intervals import Interval, positive_mean_t, ratio_t
from concord.results.figures.network_errors import (
    RunTruths,
    errors_alone,
    network_errors,
    scored_steps,
    where_counted,
)
from concord.results.figures.run_figures import traffic_of
from concord.results.figures.smoothed_errors import shown_lags, smoothed_errors
from concord.results.innovations.figures import InnovationFigures
from concord.results.innovations.of_run import judged
from concord.results.records.histories import Histories, RunCost
from concord.results.records.trace import Past
from concord.scenarios.baselines import centralised_of_runs, local_only_of_runs
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import innovations_of_all
from concord.studies.few_samples import decisive_run

_TABLE_NODES = 60


class ManyNode(msgspec.Struct, frozen=True):
    """One node: errors and consistency with intervals, traffic in frames per run in the mean."""

    rmse: Interval
    rmse_local_only: Interval
    anees: Interval
    sent: float
    heard: float
    missed: float
    rejected: float


class ManySmoothed(msgspec.Struct, frozen=True):
    """RMSE of the states of `lag` steps ago, and as a multiple of the centralised smoother's."""

    lag: int
    rmse: Interval
    to_centralised: Interval


class ManyFigures(msgspec.Struct, frozen=True):
    """Figures of R runs; RMSE and disagreement in `unit`.

    Frames, and the events that nodes `noticed`, are means per run; the bus load is NaN on a bus
    without time. `suspect` is the share of the estimates whose node said that its belief does not
    fit what it had heard. `warning` names a run that decides the ratios.
    """

    scenario: str
    unit: str
    runs: int
    first_run: int
    steps: int
    rmse: Interval
    rmse_local_only: Interval
    rmse_centralised: Interval
    to_centralised: Interval
    worst_node_to_centralised: Interval
    disagreement: Interval
    anees: Interval
    anees_centralised: Interval
    shares_sent: float
    shares_missed: float
    bytes_per_step: Interval
    bus_load: Interval
    bus_load_all: Interval
    noticed: dict[str, float]
    nodes: list[ManyNode]
    seconds: float
    node_updates_per_second: float
    peak_memory_mb: float
    smoothed: list[ManySmoothed] | None = None
    suspect: float | None = None
    innovations: InnovationFigures | None = None
    verdict: str | None = None
    warning: str | None = None


def summarise(histories: Histories, cost: RunCost) -> ManyFigures:
    """Return the figures of histories with their readings."""
    setup, scenario = histories.setup, histories.setup.scenario
    assert histories.readings is not None, "keep the readings"
    score = definition_of(scenario).score
    known = RunTruths(histories.truth, histories.readings, histories.extras)
    counted = scored_steps(score, known.readings)
    runs, nodes = histories.runs.tolist(), scenario.nodes
    alone = local_only_of_runs(setup, runs, known.readings, histories.control)
    of_alone = where_counted(counted, errors_alone(setup, known, alone.mean))
    heard, own = None, histories.innovations
    if own is not None:
        heard = innovations_of_all(setup, runs, known.readings, histories.control)
    if heard is None:
        belief = centralised_of_runs(setup, runs, known.readings, histories.control)
    else:
        belief = heard.belief
    errors = network_errors(setup, known, histories.mean, histories.nees, belief)
    of_node, of_central, spread, consistency, consistency_central = errors.where(counted)
    per_node, per_alone = rmse(of_node, (1,)), rmse(of_alone, (1,))
    central = rmse(of_central, (1,))
    whole = rmse(of_node, (1, 2))
    carried = traffic_of(setup, histories)
    innovations = sentence = None
    if own is not None and heard is not None:
        nees = mean_of_known(consistency, (2,))
        innovations, sentence = judged(setup, own, heard, counted, nees)
    return ManyFigures(
        scenario=scenario.name,
        unit=score.unit,
        runs=len(runs),
        first_run=runs[0],
        steps=scenario.steps,
        rmse=positive_mean_t(whole),
        rmse_local_only=positive_mean_t(rmse(of_alone, (1, 2))),
        rmse_centralised=positive_mean_t(central),
        to_centralised=ratio_t(whole**2, central**2),
        worst_node_to_centralised=positive_mean_t(largest_of_known(per_node) / central),
        disagreement=positive_mean_t(rmse(spread, (1, 2))),
        anees=positive_mean_t(mean_of_known(consistency, (1, 2))),
        anees_centralised=positive_mean_t(mean_of_known(consistency_central, (1,))),
        shares_sent=float(_frames(histories, "sent").sum()),
        shares_missed=float(_frames(histories, "missed").sum()),
        bytes_per_step=positive_mean_t(carried["bytes_per_step"]),
        bus_load=positive_mean_t(carried["bus_load"]),
        bus_load_all=positive_mean_t(carried["bus_load_all"]),
        noticed={
            name: float(count.sum(axis=1).mean())
            for name, count in sorted(histories.counters.items())
            if name not in ("sent", "heard", "missed")
        },
        nodes=[
            ManyNode(
                positive_mean_t(per_node[:, node]),
                positive_mean_t(per_alone[:, node]),
                positive_mean_t(mean_of_known(consistency[:, :, node], (1,))),
                *(float(_frames(histories, name)[node]) for name in _TRAFFIC),
            )
            for node in range(nodes)
        ],
        seconds=cost.seconds,
        node_updates_per_second=histories.mean[..., 0].size / cost.seconds,
        peak_memory_mb=cost.peak_memory_mb,
        suspect=None if histories.suspect is None else float(histories.suspect.mean()),
        smoothed=histories.past and _smoothed(histories, histories.past, counted, belief),
        innovations=innovations,
        verdict=sentence,
        warning=decisive_run(whole, runs[0]),
    )


def _smoothed(
    histories: Histories, past: Past, counted: np.ndarray, heard: Gaussian
) -> list[ManySmoothed]:
    known = histories.truth, histories.control, counted
    network, central = smoothed_errors(histories.setup, past, heard, *known)
    return [
        ManySmoothed(lag, positive_mean_t(mine), ratio_t(mine**2, best**2))
        for lag, (mine, best) in enumerate(zip(network.T, central.T, strict=True))
    ]


_TRAFFIC = ("sent", "heard", "missed", "rejected")


def _frames(histories: Histories, name: str) -> np.ndarray:
    """Return each node's count under a name, or under names that begin with it, per run (N,)."""
    none = np.zeros((len(histories.runs), histories.setup.scenario.nodes))
    return sum((n for key, n in histories.counters.items() if key.startswith(name)), none).mean(0)


def table(figures: ManyFigures, title: str) -> Table:
    """A row per node of a network that is not too large, then the network, then its frame."""
    unit = f"[{figures.unit}]"
    grid = Table(title=title, title_justify="left")
    for heading in ("node", f"RMSE {unit}", f"alone {unit}", "ANEES"):
        grid.add_column(heading, justify="right")
    for heading in _TRAFFIC:
        grid.add_column(heading, justify="right")
    if len(figures.nodes) <= _TABLE_NODES:
        for number, node in enumerate(figures.nodes):
            traffic = (node.sent, node.heard, node.missed, node.rejected)
            grid.add_row(
                str(number), *map(_middle, (node.rmse, node.rmse_local_only, node.anees)),
                *(f"{count:,.0f}" for count in traffic),
            )  # fmt: skip
        grid.add_section()
    grid.add_row(
        "all", *map(shown, (figures.rmse, figures.rmse_local_only, figures.anees)),
        f"{figures.shares_sent:,.0f}", "", f"{figures.shares_missed:,.0f}", "",
    )  # fmt: skip
    central = figures.rmse_centralised, figures.anees_centralised
    grid.add_row("centralised", shown(central[0]), "", shown(central[1]))
    return grid


def lines(figures: ManyFigures) -> list[str]:
    """Return the lines below the table: figures that have no column."""
    ratios = figures.to_centralised, figures.worst_node_to_centralised
    busy = figures.bus_load.value
    over_all = figures.bus_load_all.value
    load = (
        ""
        if np.isnan(busy)
        else f", bus load {100 * busy:.3g} % (over all cycles {100 * over_all:.2g} %)"
    )
    framed = (
        ""
        if np.isnan(ratios[0].value)
        else f"network {shown(ratios[0])} x centralised, worst node {shown(ratios[1])} x; "
    )
    counts = ", ".join(f"{name} {count:.4g}" for name, count in figures.noticed.items())
    smoothed = (
        [figures.smoothed[lag] for lag in shown_lags(len(figures.smoothed))]
        if figures.smoothed
        else []
    )
    past = ", ".join(f"{shown(one.to_centralised)} at {one.lag}" for one in smoothed)
    return [
        f"{figures.runs} runs from run {figures.first_run} on; ± is the 95 % interval of the mean",
        f"{framed}disagreement {shown(figures.disagreement)} {figures.unit}",
        *(
            [f"{100 * figures.suspect:.3g} % of the estimates are suspect"]
            if figures.suspect
            else []
        ),
        *([f"smoothed, x the centralised smoother of that lag in steps: {past}"] if past else []),
        *([f"nodes noticed per run: {counts}"] if counts else []),
        f"{shown(figures.bytes_per_step)} B per step on the wire{load}",
        f"{figures.seconds:.2f} s, {figures.node_updates_per_second:,.0f} node updates per second, "
        f"peak memory {figures.peak_memory_mb:.0f} MB",
        *([f"warning: {figures.warning}"] if figures.warning else []),
    ]


def _middle(interval: Interval) -> str:
    return shown(Interval(interval.value, np.nan, np.nan))


def shown(interval: Interval) -> str:
    """A figure and the spread of its interval."""
    if np.isnan(interval.value):
        return "-"
    return f"{interval.value:.4g} {interval.spread('± ')}".rstrip()
