"""The paper's rule beside those of its references, and the loop closed through estimates.

Reference [50] is the Kalman-consensus filter (`kcf`). Reference [49] averages information over the
network; information-weighted consensus (`icf`) is the nearest rule here. Errors are exact, without
runs. The "sensorless" loop is driven by the estimate of a node without a sensor, on the noise with
which the true state drives it as well.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from concord.papers.kit.figures import save, shown
from concord.papers.kit.judging import Check, Claim, NamedFigures, at_most, needs
from concord.papers.kit.report import Section, markdown_table
from concord.papers.wac.responses import BLIND_NODE, OUTPUT, ROUNDS
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.studies.exact.results import Exact, exact_of
from concord.studies.monte_carlo.simulate import simulate

PLANTS = {
    "cruise": "cruise-control",
    "bus": "suspension",
    "pitch": "aircraft-pitch",
    "speed": "dc-motor-speed",
    "position": "dc-motor-position",
}
RULES = {"wac": "paper", "ci": "-", "hcmci": "-", "icf": "[49]", "kcf": "[50]"}
STEPS, RUNS = 100, 12
BOUNDED = 3.0
"""The distance of a bounded loop grows by less from the first half of the steps to the second."""


class SensorlessLoop(NamedTuple):
    """Root mean square distance of the output from that of the loop through the true state, over
    the output itself; and that distance in the second half of the steps over the first half."""

    away: float
    growth: float


def _scenario(plant: str, **options: object) -> Scenario:
    usual = {"rule": "wac", "rounds": ROUNDS, "schedule": "full", "graph": "ring", "bus": "ideal"}
    usual |= {"steps": STEPS}
    return scenario_of(PLANTS[plant], nodes=8, **{**usual, **options})


def measure() -> dict[str, dict[str, Exact]]:
    """The exact errors by plant and rule."""
    return {
        plant: {rule: exact_of(prepare(_scenario(plant, rule=rule))) for rule in RULES}
        for plant in PLANTS
    }


def sensorless(seed: int) -> dict[str, SensorlessLoop]:
    """The loop through the estimate of the blind node beside that through the true state."""
    found = {}
    for plant in PLANTS:
        outputs = []
        for control in ("truth", str(BLIND_NODE)):
            setup = prepare(_scenario(plant, control=control, seed=seed))
            outputs.append(simulate(setup, range(RUNS), keep=()).truth[..., OUTPUT[plant]])
        apart = outputs[1] - outputs[0]
        first, second = map(_size, np.split(apart, 2, axis=1))
        found[plant] = SensorlessLoop(_size(apart) / _size(outputs[0]), second / first)
    return found


def _size(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def section(
    place: int, folder: Path, exact: dict[str, dict[str, Exact]], loops: dict[str, SensorlessLoop]
) -> Section:
    """Tables of both, and the figure of the rules."""
    rows = [
        (rule, source, *(_cell(exact[plant][rule]) for plant in PLANTS))
        for rule, source in RULES.items()
    ]
    head = ("rule", "source", *PLANTS)
    text = (
        f"Eight nodes on a ring, {ROUNDS} rounds, {STEPS} steps, matched noise, exact. A cell has "
        "the RMSE of the scored states over the centralised one, ANEES, and the largest eigenvalue "
        "of P^-1 E[e e'] over nodes and steps; above 1 the rule is overconfident.\n\n"
    )
    driven = [(plant, f"{one.away:.2g}", f"{one.growth:.2g}") for plant, one in loops.items()]
    text += markdown_table(head, rows)
    text += (
        "\n\nThe sensorless loop: the controller takes the estimate of node "
        f"{BLIND_NODE}, which measures nothing. {RUNS} runs. Distances are from the output of the "
        "loop through the truth, over that output. The bus is at rest there, and the first error "
        "of the estimate alone moves it.\n\n"
    )
    text += markdown_table(("plant", "distance", "second half of the steps over first"), driven)
    file = _draw(folder, exact)
    caption = "Error of each rule over the centralised filter's, exact"
    checks: list[Check] = [
        at_most(
            f"{plant}: wac is never overconfident", float(one["wac"].overconfidence.max()), 1 + 1e-6
        )
        for plant, one in exact.items()
    ]
    data = {"sensorless": {plant: one._asdict() for plant, one in loops.items()}, "files": [file]}
    title = "References [49] and [50], and the sensorless loop"
    return Section(place, title, f"{text}\n\n{shown(caption, file)}", checks, data=data)


def _cell(exact: Exact) -> str:
    ratio = exact.rmse.value / exact.rmse_centralised
    return f"{ratio:.2f} / {exact.anees:.2f} / {exact.overconfidence.max():.2f}"


def _draw(folder: Path, exact: dict[str, dict[str, Exact]]) -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    for axes, (plant, rules) in zip(figure.subplots(2, 3).flat, exact.items(), strict=False):
        for rule, one in rules.items():
            ratio = np.sqrt(one.squares[0].mean(-1) / one.squares_centralised)
            axes.plot(ratio, "--" if rule == "icf" else "-", label=rule, linewidth=1)
        axes.set(title=plant, xlabel="step", yscale="log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
    figure.axes[0].set_ylabel("RMSE over the centralised")
    last = figure.axes[-1]
    last.legend(*figure.axes[0].get_legend_handles_labels(), loc="center", frameon=False)
    last.set_axis_off()
    return save(figure, folder, "baselines")


def claims(measured: NamedFigures, loops: dict[str, SensorlessLoop]) -> list[Claim]:
    """Equation (24) on the loops with a pair of dominant poles, and the sensorless loop."""
    found = []
    for name, poles in (("pitch_small", (-1.94, 2.10)), ("speed_step", (-5.0, 1.0))):
        step = measured[name]
        natural = float(np.hypot(*poles))
        damping = -poles[0] / natural
        log = np.log(max(step.overshoot_percent, 1e-9) / 100) ** 2
        least_natural, least_damping = 1.8 / step.rise_time_s, np.sqrt(log / (np.pi**2 + log))
        found.append(
            Claim("(24)", f"w_n >= 1.8 / t_r and zeta >= f(M_p), on the loop {name.split('_')[0]}",
                [needs(natural / least_natural, at_least=1.0),
                 needs(damping / least_damping, at_least=1.0)],
                f"w_n {natural:.2f} beside {least_natural:.2f} rad/s, zeta {damping:.3f} beside "
                f"{least_damping:.3f}: a rule for two poles without a zero, and these loops have "
                "more", test="every finding")
        )  # fmt: skip
    away = ", ".join(f"{plant} {one.away:.2g}" for plant, one in loops.items())
    growth = max(one.growth for one in loops.values())
    found.append(
        Claim("title, VI", "the estimates allow a design without sensors",
            [needs(one.growth, at_most=BOUNDED) for one in loops.values()],
            "closed through a node without sensor, with matched noise. Distance from the output "
            f"of the loop through the truth, over that output: {away}. The bus is at rest there. "
            f"From the first half of the steps to the second it grows by {growth:.2g} at most")
    )  # fmt: skip
    return found
