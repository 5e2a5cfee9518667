"""The figures of one run, as a value for machines; `summary_table` has them for people."""

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import partial

import msgspec
import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import largest_of_known, mean_of_known, rmse
from concord.results.bus import bus_report
from concord.results.bus.bus_report import BusFigures
from concord.results.figures.containment import Containment, containment
from concord.results.figures.network_errors import (
    NetworkErrors,
    RunTruths,
    errors_alone,
    network_errors,
    scored_steps,
)
from concord.results.figures.smoothed_errors import smoothed_errors
from concord.results.figures.timing_figures import TimingFigures
from concord.results.innovations.figures import InnovationFigures
from concord.results.innovations.of_run import (
    RunInnovations,
    judged_run,
    run_innovations,
)
from concord.results.records import record_spread
from concord.results.records.extras import ExtraFigures, run_extras
from concord.results.records.record_spread import SpreadFigures
from concord.results.records.trace import Past, Trace
from concord.results.run_verdict import anees_interval
from concord.results.smoothing import SmoothingFigures
from concord.scenarios.baselines import centralised, local_only
from concord.scenarios.catalogue import definition_of, scored_nees
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario_definition import Score
from concord.scenarios.setup import Setup

_TRAFFIC = ("sent", "heard", "missed")


class SmoothedFigure(msgspec.Struct, frozen=True):
    """RMSE of the states of `lag` steps ago, and of a smoother that hears everything."""

    lag: int
    rmse: float
    rmse_centralised: float


class LabelledFigures(msgspec.Struct, frozen=True):
    """Figures of a run under rule `labelled` in place of its own.

    `options` are those that choose it; `wire_bytes_per_step` is None on a bus without time.
    """

    options: str
    rmse: float
    wire_bytes_per_step: float | None


class NodeFigures(msgspec.Struct, frozen=True):
    """One node: its error in the network and alone, its consistency, and its traffic in frames.

    Where estimates are sets, `containment` stands in place of `anees`, which is NaN.
    """

    rmse: float
    rmse_local_only: float
    anees: float
    sent: int
    heard: int
    missed: int
    rejected: int
    containment: Containment | None = None


class Figures(msgspec.Struct, frozen=True):
    """Figures of a run. RMSE and disagreement are in `unit`, from step `first_step` on.

    `anees_interval` has the ends of the 95 % interval of `anees`; None for too few steps.
    `bus` is None on a bus without time; `timing` is None except in real time. `noticed` sums the
    nodes' counters other than traffic: frames lost, late, repeated, rejected and why. `suspect` is
    the number of steps in which each node said that its belief does not fit what it had heard.
    `labelled` are the figures under that rule, where they are known. `innovations` and `verdict`
    are None where estimates are sets, or sensors have no filter. `tracking` are those of scenarios
    with `RunExtras`.
    """

    scenario: str
    unit: str
    steps: int
    first_step: int
    rmse: float
    rmse_local_only: float
    rmse_centralised: float
    worst_node_to_centralised: float
    disagreement: float
    anees: float
    anees_centralised: float
    near_s: float | None
    rmse_near: list[float]
    rmse_near_local_only: list[float]
    rmse_near_centralised: float
    shares_sent: int
    shares_missed: int
    noticed: dict[str, int]
    bus: BusFigures | None
    nodes: list[NodeFigures]
    containment: Containment | None = None
    containment_centralised: Containment | None = None
    spread: SpreadFigures | None = None
    smoothing: SmoothingFigures | None = None
    timing: TimingFigures | None = None
    smoothed: list[SmoothedFigure] | None = None
    suspect: list[int] | None = None
    anees_interval: tuple[float, float] | None = None
    steps_per_second: float | None = None
    ready_s: float | None = None
    labelled: LabelledFigures | None = None
    innovations: InnovationFigures | None = None
    verdict: str | None = None
    tracking: ExtraFigures | None = None


def summarise(setup: Setup, trace: Trace, found: RunInnovations | None = None) -> Figures:
    """The figures of a trace with at least one complete step.

    `found` are its innovations, which are computed where they are not given.
    """
    score = definition_of(setup.scenario).score
    found = found or run_innovations(setup, trace)
    central = _centralised(setup, trace, found)
    errors, of_alone, first = _errors_of(setup, trace, central)
    per_node, per_alone = rmse(errors.nodes, (0,)), rmse(of_alone, (0,))
    who = _believers(trace)
    central_rmse = float(rmse(errors.centre, (0,)))
    near = _near_steps(score, trace, setup.time_step_s)[first:]
    consistency = mean_of_known(errors.nees, (0,))
    set_valued, counters = is_set_valued(setup.scenario), trace.counters
    contained = partial(_contained, trace) if set_valued else lambda _: None
    per_step = mean_of_known(errors.nees, (1,))
    of_steps = anees_interval(per_step)
    innovations, sentence = judged_run(setup, found, first, per_step)
    extras = run_extras(setup.scenario)
    return Figures(
        scenario=setup.scenario.name,
        unit=score.unit,
        steps=trace.steps,
        first_step=first,
        rmse=float(rmse(errors.nodes, (0, 1))),
        rmse_local_only=float(rmse(of_alone[:, who], (0, 1))),
        rmse_centralised=central_rmse,
        worst_node_to_centralised=float(largest_of_known(per_node[who]) / central_rmse),
        disagreement=float(rmse(errors.spread[:, who], (0, 1))),
        anees=float(mean_of_known(errors.nees, (0, 1))),
        anees_centralised=float(mean_of_known(errors.nees_centre, (0,))),
        near_s=score.near_s,
        rmse_near=rmse(errors.nodes[near], (0,)).tolist(),
        rmse_near_local_only=rmse(of_alone[near], (0,)).tolist(),
        rmse_near_centralised=float(rmse(errors.centre[near], (0,))),
        shares_sent=sum(c.get("sent", 0) for c in counters),
        shares_missed=sum(c.get("missed", 0) for c in counters),
        noticed=noticed(counters),
        bus=bus_report.figures_of(setup, trace),
        nodes=[
            NodeFigures(
                rmse=float(per_node[i]),
                rmse_local_only=float(per_alone[i]),
                anees=float(consistency[i]),
                sent=c.get("sent", 0),
                heard=c.get("heard", 0),
                missed=c.get("missed", 0),
                rejected=sum(n for name, n in c.items() if name.startswith("rejected")),
                containment=contained(i),
            )
            for i, c in enumerate(counters)
        ],
        containment=contained(who),
        containment_centralised=containment(central, trace.truth) if set_valued else None,
        anees_interval=None if np.isnan(of_steps.low) else of_steps[1:],
        spread=trace.spread and record_spread.figures_of(trace.spread),
        suspect=None if trace.suspect is None else trace.suspect.sum(axis=0).tolist(),
        smoothed=trace.past and _smoothed(setup, trace, trace.past, central, first),
        innovations=innovations,
        verdict=sentence,
        tracking=extras and extras.figures(setup, trace.extra, trace.readings),
    )


def _believers(trace: Trace) -> slice | np.ndarray:
    """The nodes that estimate: the sensors of a measurement bus believe nothing."""
    believers = ~np.isnan(trace.mean).all(axis=(0, 2))
    return slice(None) if believers.all() else np.flatnonzero(believers)


def _centralised(setup: Setup, trace: Trace, found: RunInnovations | None) -> Gaussian:
    """One filter that hears everything, which has innovations already where these are known."""
    if found is None:
        return centralised(setup, trace.readings, trace.control)
    return Gaussian(found.heard.belief.mean[0], found.heard.belief.cov[0])


def _smoothed(
    setup: Setup, trace: Trace, past: Past, central: Gaussian, first: int
) -> list[SmoothedFigure]:
    errors = smoothed_errors(
        setup,
        Past(past.mean[None], past.std[None]),
        Gaussian(central.mean[None], central.cov[None]),
        trace.truth[None],
        None if trace.control is None else trace.control[None],
        np.arange(trace.steps)[None] >= first,
    )
    pairs = zip(errors.network[0].tolist(), errors.centralised[0].tolist(), strict=True)
    return [SmoothedFigure(lag, *pair) for lag, pair in enumerate(pairs)]


def noticed(counters: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """Return the sums of all counters by name, except shares sent, heard and missed."""
    total = sum((Counter(one) for one in counters), Counter())
    return {name: total[name] for name in sorted(total) if name not in _TRAFFIC}


def _contained(trace: Trace, who: int | slice | np.ndarray) -> Containment | None:
    """Whether the sets of some nodes hold the truth; None for nodes that estimate nothing."""
    mean, cov = trace.mean[:, who], trace.cov[:, who]
    if np.isnan(mean).all():
        return None
    steps, nodes = trace.mean.shape[:2]
    present = [[trace.history.is_in(i, k) for i in range(nodes)] for k in range(steps)]
    return containment(Gaussian(mean, cov), trace.truth, np.array(present)[:, who])


def _errors_of(
    setup: Setup, trace: Trace, central: Gaussian
) -> tuple[NetworkErrors, np.ndarray, int]:
    """Errors of the network and of each node alone, from the first scored step on, and that."""
    extras = () if trace.extra is None else (trace.extra,)
    known = RunTruths(trace.truth[None], trace.readings[None], extras)
    score = definition_of(setup.scenario).score
    first = int(scored_steps(score, known.readings)[0].argmax())
    alone = local_only(setup, trace.readings, trace.control)
    nees = scored_nees(setup.scenario, trace.mean - trace.truth[:, None], trace.cov)
    centre = Gaussian(central.mean[None], central.cov[None])
    errors = network_errors(setup, known, trace.mean[None], nees[None], centre)
    of_alone = errors_alone(setup, known, alone.mean[None])
    return errors.of_run(first), of_alone[0, first:], first


def _near_steps(score: Score, trace: Trace, time_step_s: float) -> np.ndarray:
    """Which steps (steps,) are at most `near_s` after a reading by any node."""
    if score.near_s is None:
        return np.ones(trace.steps, dtype=bool)
    seen = ~np.isnan(trace.readings).all((1, 2, 3))
    reach = round(score.near_s / time_step_s)
    return np.convolve(seen, np.ones(reach + 1))[: trace.steps] > 0.5
