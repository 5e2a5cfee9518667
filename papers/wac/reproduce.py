"""The weighted-average-consensus paper: its figures, its claims, and the study that corrects it.

B. L. Widjiantoro, M. K. Wafi and K. Indriawati, "Non-Linear Estimation using the Weighted Average
Consensus-Based Unscented Filtering for Various Vehicles Dynamics towards Autonomous Sensorless
Design".
"""

from collections.abc import Iterator
from pathlib import Path

from concord.papers.kit.figures import shown, write_traces
from concord.papers.kit.report import Paper, Section
from concord.papers.wac import (
    baselines,
    bus,
    exact,
    figures,
    loops,
    printed_filter,
    responses,
    unstable,
)
from concord.papers.wac.claims import ERRATA, gather, judge
from concord.studies.progress import progress

CLAIMS, LIST, FIGURES, LOOPS, UNSTABLE, BASELINES, PRINTED, BUS = range(8)
MOTOR_SHARE = 2
"""A motor needs half as many runs as a target."""


def _sections(folder: Path, seed: int, runs: int) -> Iterator[Section]:
    """Everything, the quick first; pictures go to `folder`."""
    with progress("closed loops and root loci", 2) as done:
        measured = loops.measure()
        done(1)
        locus = figures.draw_loci(folder)
        done(2)
    yield Section(
        LOOPS,
        "Closed loops",
        "Digital, the control held over each sampling time, from the true state, without noise.",
        loops.checks_of(measured),
    )
    without_bound = unstable.measure()
    yield unstable.section(UNSTABLE, without_bound)
    trials = responses.measure(seed)
    pictures = [locus, *figures.draw(trials, folder)]
    text = [_NETWORK, *map(shown, _CAPTIONS, pictures)]
    yield Section(FIGURES, "Figures", "\n\n".join(text), data={"files": pictures})
    _write(folder, trials)
    yield printed_filter.section(PRINTED, printed_filter.measure(seed))
    sensorless = baselines.sensorless(seed)
    yield baselines.section(BASELINES, folder, baselines.measure(), sensorless)
    claims = judge(gather(measured, exact.measure(), without_bound, trials))
    claims += baselines.claims(measured, sensorless)
    yield Section(CLAIMS, "Claims of the paper", claims=claims)
    yield Section(LIST, "Errata", errata=ERRATA)
    tracking = bus.track(seed, runs)
    turning = bus.motor(seed, max(2, runs // MOTOR_SHARE))
    yield bus.section(BUS, bus.measure(tracking, turning), tracking, turning)


_NETWORK = (
    "The paper names neither network nor noise. Eight nodes on a ring run its rule (wac, three "
    "rounds per step, Metropolis weights) with matched noise; the loop is closed through the "
    "true state; x_u is the estimate of node 3, which has no sensor, y what node 0 measures."
)
_CAPTIONS = (
    "Fig. 7: root loci. The paper prints no compensator; a gain of 1 is the tutorial's or this "
    "project's.",
    "Fig. 10: cruise control, pole -1.5, placed at exp(-1.5 t). Right: the nominal force of "
    "the paper, without feedback.",
    "Fig. 11: quarter-bus suspension over a road step, with the tutorial's gains. Below, each "
    "state in units of its peak.",
    "Fig. 12: pitch under the LQR with p = 50, and with the elevator held. Below, the angle of "
    "attack, which nobody controls.",
    "Fig. 13: speed of the motor, poles -5 ± i; references are this project's.",
    "Fig. 14: position of the motor, poles -5 ± i and -15, as the printed poles are unstable "
    "at this sampling time.",
)


def _write(folder: Path, trials: dict[str, dict[str, responses.Trial]]) -> None:
    variables = {}
    for plant, loops_ in trials.items():
        for number, trial in enumerate(loops_.values()):
            axes = (f"{plant}_step", f"{plant}_state")
            for name in ("truth", "estimated", "central"):
                variables[f"{plant}_{number}_{name}"] = (axes, getattr(trial, name))
            variables[f"{plant}_{number}_measured"] = (axes[:1], trial.measured)
    write_traces(folder, variables, {})


PAPER = Paper(
    "Weighted-average consensus (Widjiantoro et al.), reproduced",
    seed=1,
    runs=24,
    least_runs=2,
    because="runs of the limited bus, so that an interval can be made",
    sections=_sections,
)
