"""The charts of a page. A new chart is one more value here, and touches no other file."""

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import state_table
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Chart, Column, Line, Sample, of_frames
from concord.dashboard.panels.nis_chart import nis_chart
from concord.entries import chosen, entries
from concord.scenarios.preparation import share_bytes

_LOWER, _UPPER = "−3σ", "+3σ"


def run_charts(stage: Stage) -> tuple[Chart, ...]:
    """Return the charts of the network: error, disagreement, consistency, traffic."""
    own = stage.own
    errors = (_error_chart(stage),) if own is None else own.charts()
    unit = stage.score.unit if own is None else own.belief_unit
    return (
        *errors,
        Chart(
            f"Disagreement of the nodes{_scored(stage)}",
            unit,
            (Line("rms spread", lambda t: t.estimate, of_frames(lambda f: f.scores.spread)),),
        ),
        Chart(
            "NEES, mean of the nodes",
            "1",
            (
                Line("NEES", lambda t: t.estimate, of_frames(lambda f: f.scores.nees)),
                Line("95 % of runs from", lambda t: t.quiet, lambda s: s.expected.nees_low, True),
                Line("to", lambda t: t.quiet, lambda s: s.expected.nees_high, True),
            ),
        ),
        nis_chart(),
        _payload_chart(stage),
        *(chart for name in entries("CHARTS") for chart in chosen("CHARTS", name)(stage)),
    )


def _error_chart(stage: Stage) -> Chart:
    return Chart(
        f"RMSE of the nodes{_scored(stage)}",
        stage.score.unit,
        (
            Line("nodes", lambda t: t.seeing, of_frames(lambda f: f.scores.rmse)),
            Line(stage.fused_name, lambda t: t.fused, of_frames(lambda f: f.scores.fused)),
            Line("centralised", lambda t: t.text, of_frames(lambda f: f.scores.central)),
            Line("Cramér-Rao bound", lambda t: t.quiet, lambda s: s.expected.bound, True),
        ),
    )


def _payload_chart(stage: Stage) -> Chart:
    """Return the chart of the payload, in bytes where a frame in each cycle makes no kB/s."""
    seconds = stage.setup.time_step_s
    is_slow = stage.rounds * share_bytes(stage.setup) < 1e3 * seconds
    unit, of_unit = ("B/s", 1.0) if is_slow else ("kB/s", 1e3)

    def payload(frame: StepFrame) -> float:
        return sum(cycle.payload_bytes for cycle in frame.cycles) / seconds / of_unit

    return Chart(
        "Payload on the bus", unit, (Line("payload", lambda t: t.seeing, of_frames(payload)),)
    )


def _scored(stage: Stage) -> str:
    """Return the states that errors are of; nothing where a place says it already."""
    states = stage.score.states
    if stage.place or len(states) == len(stage.state_names):
        return ""
    return ", " + ", ".join(stage.state_names[state] for state in states)


def state_charts() -> tuple[Chart, ...]:
    """Return the charts of the chosen state at the selected node: the state, and its error."""
    return (
        Chart(
            "State",
            "1",
            (
                Line("truth", lambda t: t.truth, _truth),
                Line("node", lambda t: t.estimate, _mean),
                Line(_LOWER, lambda t: t.quiet, lambda s: _mean(s) - _reach(s), True),
                Line(_UPPER, lambda t: t.quiet, lambda s: _mean(s) + _reach(s), True),
            ),
            from_zero=False,
            about=lambda s: _state_name(s, ""),
        ),
        Chart(
            "Error",
            "1",
            (
                Line("error", lambda t: t.estimate, lambda s: _mean(s) - _truth(s)),
                Line(_LOWER, lambda t: t.quiet, lambda s: -_reach(s), True),
                Line(_UPPER, lambda t: t.quiet, lambda s: _reach(s), True),
            ),
            from_zero=False,
            about=lambda s: _state_name(s, "error of "),
        ),
    )


def _state_name(sample: Sample, before: str) -> tuple[str, str]:
    """Return the name of the chosen state at the selected node, and its unit."""
    stage, view = sample.stage, sample.view
    node = stage.names[view.selected or 0]
    return f"{before}{stage.state_names[view.state]}, node {node}", stage.state_units[view.state]


def _of_state(column: int) -> Column:
    def values(sample: Sample) -> np.ndarray:
        view = sample.view
        return state_table(sample.frames, view.selected or 0, view.state)[:, column]

    return values


_truth, _mean, _deviation = _of_state(0), _of_state(1), _of_state(2)


def _reach(sample: Sample) -> np.ndarray:
    return np.array([frame.stage.deviations for frame in sample.frames]) * _deviation(sample)
