"""Figs. 7 and 10-14 of the consensus paper as pictures; lines differ in width and dash too."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from concord.features.control.transfer_functions import root_locus
from concord.papers.kit.figures import BLACK, BLUE, GREY, ORANGE, SKY, VERMILION, legend_below, save
from concord.papers.wac.loops import Panel, figure_7
from concord.papers.wac.responses import OUTPUT, Trial

DPI = 110
MOST_DOTS = 400
# By plant: name of the file, label of the output, label of its error.
FOLLOWERS = {
    "cruise": ("fig10_cruise", "speed $v$ [m/s]", "error of $v$ [m/s]"),
    "pitch": ("fig12_pitch", "pitch angle $\\theta$ [rad]", "error of $\\theta$ [rad]"),
    "speed": ("fig13_motor_speed", "motor speed [rad/s]", "error of speed [rad/s]"),
    "position": (
        "fig14_motor_position", "motor position $\\theta$ [rad]", "error of $\\theta$ [rad]",
    ),
}  # fmt: skip


def draw(trials: dict[str, dict[str, Trial]], folder: Path) -> list[str]:
    """Write the five pictures of Figs. 10-14; returns their names."""
    drawn = {
        name: _followers(plant, trials[plant], output, error)
        for plant, (name, output, error) in FOLLOWERS.items()
    }
    drawn["fig11_suspension"] = _bus(trials["bus"])
    return [save(drawn[name], folder, name, DPI) for name in sorted(drawn)]


def _followers(plant: str, trials: dict[str, Trial], output: str, error: str) -> Figure:
    """A column per loop: the output, its errors, and for the aircraft a state without reference."""
    rows = 3 if plant == "pitch" else 2
    width = max(4.2 * len(trials), 11.0)  # below that the legend is cut
    figure = Figure(figsize=(width, 2.9 * rows), layout="constrained")
    grid = figure.subplots(rows, len(trials), squeeze=False, sharex="col")
    # Room for the errors of the measurements: a start far off the truth would flatten the rest.
    largest = max(np.abs(t.measured - t.truth[:, OUTPUT[plant]]).max() for t in trials.values())
    for column, (title, trial) in zip(grid.T, trials.items(), strict=True):
        column[0].set_title(title, fontsize=11)
        _output(column[0], trial, OUTPUT[plant])
        _errors(column[1], trial, OUTPUT[plant])
        column[1].set_ylim(-1.05 * largest, 1.05 * largest)
        if plant == "pitch":
            _true_and_estimated(column[2], trial, 0)
            column[2].axhline(0, color=GREY, linewidth=0.6)
        column[-1].set_xlabel("time [s]")
    labels = (output, error, "angle of attack $\\alpha$ [rad]")
    for axes, label in zip(grid[:, 0], labels, strict=False):
        axes.set_ylabel(label)
    legend_below(figure, grid[0, 0], grid[1, 0], ncols=5, fontsize=9)
    return figure


def _bus(trials: dict[str, Trial]) -> Figure:
    """Above the travel y1, below the other states, each in units of its own peak."""
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    for column, (title, trial) in zip(grid.T, trials.items(), strict=True):
        column[0].set_title(f"{title}, road step of 0.1 m", fontsize=11)
        in_millimetres = {
            name: 1e3 * getattr(trial, name) for name in ("truth", "measured", "estimated")
        }
        _output(column[0], trial._replace(**in_millimetres), OUTPUT["bus"])
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
    values = [trial.measured, trial.truth[:, output]]
    if trial.reference is not None:
        axes.plot(
            trial.times_s, trial.reference, "--", color=GREY, linewidth=1.5, label="reference $r$",
            zorder=2,
        )  # fmt: skip
        values.append(trial.reference)
    _true_and_estimated(axes, trial, output)
    low, high = np.min(np.concatenate(values)), np.max(np.concatenate(values))
    margin = 0.08 * (high - low)
    axes.set_ylim(low - margin, high + margin)


def _true_and_estimated(axes: Axes, trial: Trial, state: int) -> None:
    axes.plot(
        trial.times_s, trial.truth[:, state], color=BLACK, linewidth=2.6, label="true $x_t$",
        zorder=3,
    )  # fmt: skip
    axes.plot(
        trial.times_s, trial.estimated[:, state], color=ORANGE, linewidth=1.2,
        label="estimated $x_u$ (node 3, no sensor)", zorder=4,
    )  # fmt: skip


def _errors(axes: Axes, trial: Trial, output: int) -> None:
    times, truth, shown = trial.times_s, trial.truth[:, output], _thinned(trial.times_s)
    axes.plot(times[shown], (trial.measured - truth)[shown], ".", color=SKY, markersize=3, zorder=1)
    axes.plot(times, trial.estimated[:, output] - truth, color=ORANGE, linewidth=1.2)
    central = trial.central[:, output] - truth
    axes.plot(times, central, color=BLUE, linewidth=1.0, label="centralised filter")
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


def _thinned(times: np.ndarray) -> slice:
    """Every so many samples: more dots than MOST_DOTS would hide the lines."""
    return slice(None, None, max(1, len(times) // MOST_DOTS))


# --- Fig. 7: root loci, one picture of twelve ----------------------------------------------------

# Windows (re low, re high, im low, im high) in 1/s that show where each locus is decided.
WINDOWS = {
    "a": (-1.5, 0.3, -0.5, 0.5),
    "b": (-4, 0.5, -2, 2),
    "c": (-60, 20, -60, 60),
    "d": (-120, 30, -80, 80),
    "e": (-6, 2, -8, 8),
    "f": (-120, 20, -60, 60),
    "g": (-1.5, 0.5, -3, 3),
    "h": (-25, 3, -20, 20),
    "i": (-15, 3, -15, 15),
    "j": (-15, 5, -10, 10),
    "k": (-15, 5, -10, 10),
    "l": (-15, 5, -10, 10),
}
GAINS = 4000
# Their gain is in N/m, so that 1 is no design; see `loops.figure_7`.
WITHOUT_DESIGN = ("c", "d", "e")


def draw_loci(folder: Path) -> str:
    """Write the picture; returns its name."""
    figure = Figure(figsize=(14, 9.5), layout="constrained")
    grid = figure.subplots(3, 4)
    for axes, (letter, panel) in zip(grid.flat, figure_7().items(), strict=True):
        _locus(axes, panel, designed=letter not in WITHOUT_DESIGN)
        low, high, bottom, top = WINDOWS[letter]
        axes.set(xlim=(low, high), ylim=(bottom, top))
        axes.set_title(f"({letter}) {panel.title}", fontsize=11)
    for axes in grid[-1]:
        axes.set_xlabel("real part [1/s]")
    for axes in grid[:, 0]:
        axes.set_ylabel("imaginary part [rad/s]")
    legend_below(figure, grid[0, 0], ncols=5)
    return save(figure, folder, "fig07_root_loci", DPI)


def _locus(axes: Axes, panel: Panel, *, designed: bool) -> None:
    # Where branches meet, poles move with the root of the gain: that takes a fine grid.
    gains = np.geomspace(panel.gains[1], panel.gains[-1], GAINS)
    for number, branch in enumerate(root_locus(panel.loop, np.insert(gains, 0, 0.0)).T):
        label = "closed-loop poles as the gain grows" if number == 0 else None
        axes.plot(branch.real, branch.imag, color=BLUE, linewidth=1.8, label=label)
    marks = [
        (np.roots(panel.loop.denominator), "x", VERMILION, "open-loop poles"),
        (np.roots(panel.loop.numerator), "o", BLACK, "open-loop zeros"),
    ]
    if designed:
        poles = root_locus(panel.loop, np.array([0.0, 1.0]))[1]
        marks.append((poles, "D", ORANGE, "gain 1: the controller as designed"))
    for points, marker, colour, label in marks:
        axes.plot(
            np.real(points), np.imag(points), marker, color=colour, markersize=7,
            markerfacecolor="none", markeredgewidth=1.6, label=label,
        )  # fmt: skip
    axes.axvline(0, color=GREY, linewidth=0.8, zorder=0)
    axes.axhline(0, color=GREY, linewidth=0.8, zorder=0)
