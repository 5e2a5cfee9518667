"""Figures 2 to 7 of Liu et al. (2021), the size of every estimator's sets, and sets over time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from concord.features.sets.filters.ellipsoid import Ellipsoid, image, outline
from concord.papers.kit.figures import legend_below, one_axes
from concord.papers.liu2021.runs import BoundedEstimates, G, N, SequenceBatch

TRUE, PAPER, TIGHT, LIGHT = "0.15", "C0", "C1", "0.75"
COLOURS = {"paper": PAPER, "fast": "C9", "tight": TIGHT, "fast-rate": "C3", "zonotope": "C2"}
# Times at which the figure of the sets shows them.
_SHOWN_CYCLES = (0, 1, 2, 3)


def figures(batch: SequenceBatch, outcomes: dict[str, BoundedEstimates]) -> dict[str, Figure]:
    """Figures 2 to 9 of the paper's sequence by caption."""
    paper, tight = outcomes["paper"], outcomes["tight"]
    drawn = {
        f"Figure {state + 2}: state x{state + 1}, its estimate and the bounds of the paper's "
        "estimator": _state(batch, paper, tight, state)
        for state in range(N)
    }
    for number, (one, other) in ((6, (0, 1)), (7, (2, 3))):
        names = f"e{one + 1} and e{other + 1}"
        caption = f"Figure {number}: estimation errors {names} and their upper bounds"
        drawn[caption] = _errors(batch, paper, tight, (one, other))
    drawn["Figure 8: how large the sets of x are, every estimator on the paper's noise"] = _sizes(
        outcomes
    )
    drawn["Figure 9: the sets of x after the first four cycles, in two planes"] = _sets(
        batch, paper, tight, outcomes["fast-rate"]
    )
    return drawn


def blocks(outcome: BoundedEstimates) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and half-widths (steps, n) of the paper's sequence in every step of the plant.

    An estimator that works by the cycle says after it what was in each of its steps.
    """
    centres, widths = [], []
    for kept in outcome.sets:
        assert isinstance(kept, Ellipsoid), "zonotopes are kept step by step"
        centres.append(kept.centre[0, : G * N].reshape(G, N))
        spread = np.sqrt((kept.factor[0, : G * N] ** 2).sum(-1))
        widths.append(spread.reshape(G, N))
    return np.concatenate(centres), np.concatenate(widths)


def _state(
    batch: SequenceBatch, paper: BoundedEstimates, tight: BoundedEstimates, state: int
) -> Figure:
    figure, axes = one_axes(3.4, 7.2)
    _tidy(axes)
    truth = batch.states[0, :, state]
    steps = np.arange(1, len(truth))
    for outcome, colour, alpha, label in (
        (paper, PAPER, 0.15, "the paper's bounds"),
        (tight, TIGHT, 0.3, "bounds of the tight form"),
    ):
        centre, width = (part[:, state] for part in blocks(outcome))
        axes.fill_between(
            steps, centre - width, centre + width, color=colour, alpha=alpha, lw=0, label=label
        )
    estimate = blocks(paper)[0][:, state]
    axes.plot(np.arange(len(truth)), truth, color=TRUE, lw=1.6, label=f"state $x_{state + 1}$")
    axes.plot(steps, estimate, color=PAPER, lw=1.4, ls="--", label="estimate")
    axes.set(xlabel="step $T_k$", ylabel=f"$x_{state + 1}$", xlim=(0, len(truth) - 1))
    axes.legend(frameon=False, ncols=2, loc="upper left" if state == 0 else "best")
    return figure


def _errors(
    batch: SequenceBatch, paper: BoundedEstimates, tight: BoundedEstimates, states: tuple[int, int]
) -> Figure:
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    grid = figure.subplots(2, 1, sharex=True)
    centre, width = blocks(paper)
    _, narrow = blocks(tight)
    errors = batch.states[0, 1:] - centre
    steps = np.arange(1, len(errors) + 1)
    for axes, state in zip(grid, states, strict=True):
        axes.plot(steps, np.abs(errors[:, state]), color=TRUE, lw=1.4, label="error")
        axes.plot(steps, width[:, state], color=PAPER, lw=1.4, label="upper bound, paper")
        axes.plot(steps, narrow[:, state], color=TIGHT, lw=1.4, label="upper bound, tight form")
        axes.set(ylabel=f"$|e_{state + 1}|$", ylim=(0, None), xlim=(1, len(errors)))
        _tidy(axes)
    grid[0].legend(frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    grid[-1].set_xlabel("step $T_k$")
    return figure


def _sizes(outcomes: dict[str, BoundedEstimates]) -> Figure:
    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for name, outcome in outcomes.items():
        style = {"color": COLOURS[name], "lw": 1.5, "label": name}
        if len(outcome.steps) * G == outcome.steps[-1]:
            style |= {"marker": "o", "ms": 3.5}
        upper.semilogy(outcome.steps, outcome.trace[:, 0], **style)
        lower.plot(outcome.steps, outcome.half_widths[:, 0].sum(-1), **style)
    upper.set_ylabel("tr P (fast-rate: one step)")
    lower.set(xlabel="step $T_k$", ylabel="sum of half-widths of x", ylim=(0, None))
    lower.legend(frameon=False, ncols=5, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    upper.set_yticks([2, 5, 10, 20, 50], ["2", "5", "10", "20", "50"])
    upper.minorticks_off()
    for axes in (upper, lower):
        _tidy(axes)
    return figure


def _sets(
    batch: SequenceBatch,
    paper: BoundedEstimates,
    tight: BoundedEstimates,
    fast_rate: BoundedEstimates,
) -> Figure:
    """Projections, with the truth in the middle: the first state leaves every common scale."""
    figure = Figure(figsize=(7.6, 4.6), layout="constrained")
    grid = figure.subplots(2, len(_SHOWN_CYCLES))
    last = np.eye(G * N)[(G - 1) * N :]
    for column, cycle in enumerate(_SHOWN_CYCLES):
        truth = batch.states[0, (cycle + 1) * G]
        kept = {
            "paper": _first(paper.sets[cycle], np.hstack([last, np.zeros((N, 2))])),
            "tight": _first(tight.sets[cycle], last),
            "fast-rate": _first(fast_rate.sets[(cycle + 1) * G - 1], np.eye(N)),
        }
        for row, states in enumerate(((0, 1), (2, 3))):
            axes = grid[row, column]
            for name, one in kept.items():
                points = outline(one, states) - truth[list(states)]
                axes.plot(*points.T, color=COLOURS[name], lw=1.4, label=name)
            axes.plot(0, 0, "+", color=TRUE, ms=8, label="truth")
            axes.set(xlabel=f"$x_{states[0] + 1}$ - truth", ylabel=f"$x_{states[1] + 1}$ - truth")
            if row == 0:
                axes.set_title(f"$T_k$ = {(cycle + 1) * G}", fontsize=10)
            _tidy(axes)
    legend_below(figure, grid[0, 0])
    return figure


def _first(kept: object, matrix: np.ndarray) -> Ellipsoid:
    """The paper's sequence, and of its set what the matrix picks."""
    assert isinstance(kept, Ellipsoid), "zonotopes have no outline here"
    return image(Ellipsoid(kept.centre[0], kept.factor[0]), matrix)


def _tidy(axes: Axes) -> None:
    axes.grid(color=LIGHT, lw=0.4)
    axes.spines[["top", "right"]].set_visible(False)
