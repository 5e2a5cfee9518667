"""Figs. 10-14 of the consensus paper as pictures, drawn from `concord.papers.wac.responses`.

Lines differ in width and dash too.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from concord.papers.kit.figures import BLACK, BLUE, GREY, ORANGE, SKY, VERMILION, legend_below, save
from concord.papers.wac.responses import OUTPUT, Trial

DPI = 110
MOST_DOTS = 400

OUTPUT_LABELS = {
    "cruise": "speed $v$ [m/s]",
    "pitch": "pitch angle $\\theta$ [rad]",
    "speed": "motor speed [rad/s]",
    "position": "motor position $\\theta$ [rad]",
}
ERROR_LABELS = {
    "cruise": "error of $v$ [m/s]",
    "pitch": "error of $\\theta$ [rad]",
    "speed": "error of speed [rad/s]",
    "position": "error of $\\theta$ [rad]",
}
FILES = {
    "cruise": "fig10_cruise",
    "bus": "fig11_suspension",
    "pitch": "fig12_pitch",
    "speed": "fig13_motor_speed",
    "position": "fig14_motor_position",
}


def draw(trials: dict[str, dict[str, Trial]], folder: Path) -> list[str]:
    """Write all five pictures; returns their names."""
    return [
        save(
            _bus(trials["bus"]) if plant == "bus" else _followers(plant, trials[plant]),
            folder,
            name,
            DPI,
        )
        for plant, name in FILES.items()
    ]


def _followers(plant: str, trials: dict[str, Trial]) -> Figure:
    """A column per loop: the output, its errors, and for the aircraft a state without reference."""
    rows = 3 if plant == "pitch" else 2
    width = max(4.2 * len(trials), 11.0)  # below that the legend is cut
    figure = Figure(figsize=(width, 2.9 * rows), layout="constrained")
    grid = figure.subplots(rows, len(trials), squeeze=False, sharex="col")
    for column, (title, trial) in zip(grid.T, trials.items(), strict=True):
        column[0].set_title(title, fontsize=11)
        _output(column[0], trial, OUTPUT[plant])
        _errors(column[1], trial, OUTPUT[plant])
        if plant == "pitch":
            _state(column[2], trial, 0)
        column[-1].set_xlabel("time [s]")
    grid[0, 0].set_ylabel(OUTPUT_LABELS[plant])
    grid[1, 0].set_ylabel(ERROR_LABELS[plant])
    if plant == "pitch":
        grid[2, 0].set_ylabel("angle of attack $\\alpha$ [rad]")
    _share_limits(grid[1], trials, OUTPUT[plant])
    legend_below(figure, grid[0, 0], grid[1, 0], ncols=5, fontsize=9)
    return figure


def _bus(trials: dict[str, Trial]) -> Figure:
    """Above the travel y1, below the other states, each in units of its own peak."""
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    for column, (title, trial) in zip(grid.T, trials.items(), strict=True):
        column[0].set_title(f"{title}, road step of 0.1 m", fontsize=11)
        _output(column[0], _in_millimetres(trial), OUTPUT["bus"])
        _other_states(column[1], trial)
        column[1].set_xlabel("time [s]")
    grid[0, 0].set_ylabel("suspension travel $y_1$ [mm]")
    grid[1, 0].set_ylabel("state of the body / its peak (in brackets)")
    legend_below(figure, grid[0, 0], grid[0, 1], ncols=5, fontsize=9)
    return figure


def _output(axes: Axes, trial: Trial, output: int) -> None:
    shown = _thinned(trial.times_s)
    axes.plot(
        trial.times_s[shown], trial.measured[shown], ".", color=SKY, markersize=3,
        label="measured $y$ (node 0)", zorder=1,
    )  # fmt: skip
    if trial.reference is not None:
        axes.plot(
            trial.times_s, trial.reference, "--", color=GREY, linewidth=1.5, label="reference $r$",
            zorder=2,
        )  # fmt: skip
    _true_and_estimated(axes, trial, output)
    shown_values = [trial.measured, trial.truth[:, output]]
    if trial.reference is not None:
        shown_values.append(trial.reference)
    low, high = np.min(np.concatenate(shown_values)), np.max(np.concatenate(shown_values))
    margin = 0.08 * (high - low)
    axes.set_ylim(low - margin, high + margin)


def _state(axes: Axes, trial: Trial, state: int) -> None:
    _true_and_estimated(axes, trial, state)
    axes.axhline(0, color=GREY, linewidth=0.6)


def _true_and_estimated(axes: Axes, trial: Trial, state: int) -> None:
    axes.plot(
        trial.times_s,
        trial.truth[:, state],
        color=BLACK,
        linewidth=2.6,
        label="true $x_t$",
        zorder=3,
    )
    axes.plot(
        trial.times_s, trial.estimated[:, state], color=ORANGE, linewidth=1.2,
        label="estimated $x_u$ (node 3, no sensor)", zorder=4,
    )  # fmt: skip


def _errors(axes: Axes, trial: Trial, output: int) -> None:
    shown = _thinned(trial.times_s)
    truth = trial.truth[:, output]
    axes.plot(
        trial.times_s[shown],
        (trial.measured - truth)[shown],
        ".",
        color=SKY,
        markersize=3,
        zorder=1,
    )
    axes.plot(trial.times_s, trial.estimated[:, output] - truth, color=ORANGE, linewidth=1.2)
    axes.plot(
        trial.times_s, trial.central[:, output] - truth, color=BLUE, linewidth=1.0,
        label="centralised filter",
    )  # fmt: skip
    axes.axhline(0, color=GREY, linewidth=0.6)


def _other_states(axes: Axes, trial: Trial) -> None:
    # The roughest first, below the others.
    states = {
        "$x_4$": (trial.truth[:, 3], "m/s", SKY, "-"),
        "speed $x_2$": (trial.truth[:, 1], "m/s", BLUE, "--"),
        "height $x_1$": (trial.truth[:, 0], "m", VERMILION, "-"),
        "$x_5=\\int y_1$": (trial.integral, "m s", BLACK, ":"),
    }
    for name, (values, unit, colour, dash) in states.items():
        peak = np.abs(values).max()
        label = f"{name} ({peak:.2g} {unit})"
        axes.plot(trial.times_s, values / peak, dash, color=colour, linewidth=1.5, label=label)
    axes.axhline(0, color=GREY, linewidth=0.6)
    axes.set_ylim(-1.1, 1.1)
    axes.legend(
        fontsize=8, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.15), frameon=False,
        columnspacing=1.0, handlelength=1.6,
    )  # fmt: skip


def _in_millimetres(trial: Trial) -> Trial:
    reference = None if trial.reference is None else 1e3 * trial.reference
    return trial._replace(
        reference=reference,
        truth=1e3 * trial.truth,
        measured=1e3 * trial.measured,
        estimated=1e3 * trial.estimated,
    )


def _thinned(times: np.ndarray) -> slice:
    """Every so many samples: more dots than MOST_DOTS would hide the lines."""
    return slice(None, None, max(1, len(times) // MOST_DOTS))


def _share_limits(row: np.ndarray, trials: dict[str, Trial], output: int) -> None:
    """Room for the errors of the measurements: a start far off the truth would flatten the rest."""
    largest = max(np.abs(t.measured - t.truth[:, output]).max() for t in trials.values())
    for axes in row:
        axes.set_ylim(-1.05 * largest, 1.05 * largest)
