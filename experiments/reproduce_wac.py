"""The weighted-average-consensus paper: its figures, its claims, and the study that corrects it.

B. L. Widjiantoro, M. K. Wafi and K. Indriawati, "Non-Linear Estimation using the Weighted Average
Consensus-Based Unscented Filtering for Various Vehicles Dynamics towards Autonomous Sensorless
Design".
"""

from collections.abc import Iterator
from pathlib import Path

from experiments import (
    reproduce_wac_bus,
    reproduce_wac_errata,
    reproduce_wac_exact,
    reproduce_wac_exact_section,
    reproduce_wac_figures,
    reproduce_wac_loci,
    reproduce_wac_loop_checks,
    reproduce_wac_loops,
    reproduce_wac_occupancy,
    reproduce_wac_responses,
    reproduce_wac_unstable,
)
from experiments.progress import progress
from experiments.reproduce_report import Reproduction, Section
from experiments.reproduce_wac_claims import judge
from experiments.reproduce_wac_evidence import gather

SEED = 1
CLAIMS, ERRATA, FIGURES, LOOPS, EXACT, UNSTABLE, BUS = range(7)


def sections(folder: Path) -> Iterator[Section]:
    """Everything, the quick first; pictures go to `folder`."""
    with progress("closed loops and root loci", 2) as done:
        loops = reproduce_wac_loops.measure()
        done(1)
        loci = reproduce_wac_loci.draw(folder)
        done(2)
    yield Section(
        LOOPS,
        "Closed loops",
        "Digital, the control held over each sampling time, from the true state, without noise.",
        reproduce_wac_loop_checks.checks_of(loops),
    )
    unstable = reproduce_wac_unstable.measure()
    yield reproduce_wac_unstable.section(UNSTABLE, unstable)
    trials = reproduce_wac_responses.measure(SEED)
    pictures = reproduce_wac_figures.draw(trials, folder)
    yield _figures(loci, pictures)
    exact = reproduce_wac_exact.measure()
    yield reproduce_wac_exact_section.section(EXACT, exact)
    claims = judge(gather(loops, exact, unstable, trials))
    yield Section(CLAIMS, "Claims of the paper", claims=claims)
    yield reproduce_wac_errata.section(ERRATA, claims)
    tracking, turning = reproduce_wac_occupancy.track(SEED), reproduce_wac_occupancy.motor(SEED)
    occupancy = reproduce_wac_occupancy.measure(tracking, turning)
    yield reproduce_wac_bus.section(BUS, occupancy, tracking, turning)


def _figures(loci: str, pictures: list[str]) -> Section:
    captions = (
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
    text = [
        "The paper names neither network nor noise. Eight nodes on a ring run its rule (wac, three "
        "rounds per step, Metropolis weights) with matched noise; the loop is closed through the "
        "true state; x_u is the estimate of node 3, which has no sensor, y what node 0 measures."
    ]
    for name, caption in zip((loci, *pictures), captions, strict=True):
        text.append(f"![{caption}]({name})\n\n*{caption}*")
    return Section(FIGURES, "Figures", "\n\n".join(text), data={"files": [loci, *pictures]})


REPRODUCTION = Reproduction(
    "Weighted-average consensus (Widjiantoro et al.), reproduced", SEED, sections
)
