"""Figures 4, 5 and 9 of the ADLUKF paper in form: states and estimates over time."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from concord.papers.kit.figures import BLACK, BLUE, GREY, SKY, VERMILION, legend_below

TRUTH: dict[str, Any] = {"color": BLACK, "lw": 3.0, "label": "truth"}
LOGGED: dict[str, Any] = {"color": "#C8C8C8", "lw": 1.0, "label": "logged, sensor noise and all"}
LINES: dict[str, dict[str, Any]] = {
    "CKF": {"color": VERMILION, "ls": "-", "lw": 2.0},
    "FAUKF": {"color": SKY, "ls": "-", "lw": 1.3},
    "ADLUKF": {"color": BLUE, "ls": (0, (4, 1.5)), "lw": 1.1},
}
"""Where lines lie on each other, those below are wider. Colours are Okabe and Ito's, which most
people can tell apart."""
DPI = 120

YAW_RATE, SIDE_SLIP, SPEED = "yaw rate [deg/s]", "side slip [deg]", "speed $v_x$ [m/s]"
SPEED_ERROR, YAW_RATE_ERROR = "mean |error| of $v_x$ [m/s]", "mean |error| of yaw rate [deg/s]"


class StateTrace(NamedTuple):
    """States (steps, 4) in the order of `study.quantities`, for the reference and by filter.

    The reference is NaN where it is unknown. `errors` (steps, 4) are means over seeds, by filter.
    """

    title: str
    time_s: np.ndarray
    reference: np.ndarray
    estimates: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]


def manoeuvre_figure(title: str, traces: tuple[StateTrace, ...]) -> Figure:
    """Figure 4 or 5: (a) yaw rate, (b) side slip, (c) speed, (d) mean absolute error of speed.

    And (e), which the paper lacks: that of the yaw rate, whose lines (a) cannot tell apart.
    """
    figure = Figure(figsize=(6.2 * len(traces), 13.5), layout="constrained")
    grid = figure.subplots(5, len(traces), squeeze=False, sharex=True, sharey="row")
    for column, trace in zip(grid.T, traces, strict=True):
        column[0].set_title(trace.title, fontsize=11)
        _states(column[0], trace, 3, TRUTH)
        _states(column[1], trace, 2, TRUTH)
        _states(column[2], trace, 0, TRUTH)
        for axes, state in ((column[3], 0), (column[4], 3)):
            for name, error in trace.errors.items():
                axes.plot(trace.time_s, error[:, state], **LINES[name])
            axes.set(yscale="log")
            axes.grid(color=GREY, alpha=0.25, lw=0.5)
        column[4].set(xlabel="time [s]", xlim=(0, trace.time_s[-1]))
    _zoom_speed(grid[2, 0], traces)
    labels = (YAW_RATE, SIDE_SLIP, SPEED, SPEED_ERROR, YAW_RATE_ERROR)
    for axes, letter, label in zip(grid[:, 0], "abcde", labels, strict=True):
        axes.set_ylabel(f"({letter})  {label}")
    figure.suptitle(title, fontsize=12)
    legend_below(figure, grid[0, 0])
    return figure


def drives_figure(title: str, traces: tuple[StateTrace, ...]) -> Figure:
    """Figure 9: yaw rate, side slip and speed of logged drives, one column each."""
    figure = Figure(figsize=(6.2 * len(traces), 8.8), layout="constrained")
    grid = figure.subplots(3, len(traces), squeeze=False, sharex="col")
    letters = iter("abcdef")
    for column, trace in zip(grid.T, traces, strict=True):
        column[0].set_title(trace.title, fontsize=11)
        for axes, state, label in zip(column, (3, 2, 0), (YAW_RATE, SIDE_SLIP, SPEED), strict=True):
            _states(axes, trace, state, LOGGED)
            axes.set_ylabel(f"({next(letters)})  {label}")
        _zoom_speed(column[2], (trace,))
        column[2].set(xlabel="time [s]", xlim=(0, trace.time_s[-1]))
    figure.suptitle(title, fontsize=12)
    legend_below(figure, grid[0, 0])
    return figure


def _states(axes: Axes, trace: StateTrace, state: int, reference: dict[str, Any]) -> None:
    axes.plot(trace.time_s, trace.reference[:, state], **reference)
    for name, estimate in trace.estimates.items():
        axes.plot(trace.time_s, estimate[:, state], label=name, **LINES[name])
    axes.grid(color=GREY, alpha=0.25, lw=0.5)


def _zoom_speed(axes: Axes, traces: tuple[StateTrace, ...]) -> None:
    """The speed after the start error has gone; that alone would set the scale."""
    speeds = np.concatenate([trace.reference[:, 0] for trace in traces])
    settled = [e[len(e) // 20 :, 0] for trace in traces for e in trace.estimates.values()]
    low, high = (
        np.nanmin([np.nanmin(speeds), *map(np.nanmin, settled)]),
        np.nanmax([np.nanmax(speeds), *map(np.nanmax, settled)]),
    )
    margin = 0.08 * (high - low)
    axes.set_ylim(low - margin, high + margin)
