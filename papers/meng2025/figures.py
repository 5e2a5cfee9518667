"""Figures 2 to 5 of Meng et al. (2025), with the recommended filter beside the printed one."""

import numpy as np
from matplotlib.figure import Figure

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.papers.kit.figures import one_axes
from concord.papers.meng2025.runs import MeasuredBatch, SlotEstimates
from concord.papers.meng2025.table import mse_by_step, running_mse, trace_by_step

TRUE, OURS, PRINTED, DYNAMIC = "0.15", "C0", "C3", "C1"
_TWO_SIGMA = 2.0


def figures(
    batch: MeasuredBatch, recommended: SlotEstimates, printed: SlotEstimates
) -> dict[str, Figure]:
    """Figures 2 to 5 by caption, of run 0 (4: of all runs)."""
    return {
        "Figure 2: state x1 and its estimate, run 0": _states(batch, recommended, printed, 0),
        "Figure 3: state x2 and its estimate, run 0": _states(batch, recommended, printed, 1),
        f"Figure 4: mean square error over {batch.runs} runs, and what the filters report": _errors(
            batch, recommended, printed
        ),
        "Figure 5: the sensor that has access to the bus, run 0": _access(recommended),
    }


def _states(
    batch: MeasuredBatch, recommended: SlotEstimates, printed: SlotEstimates, state: int
) -> Figure:
    figure, axes = one_axes(3.6)
    steps = np.arange(len(batch.truth))
    mean = recommended.mean[:, 0, state]
    half = _TWO_SIGMA * np.sqrt(recommended.cov[:, 0, state, state])
    axes.fill_between(steps, mean - half, mean + half, color=OURS, alpha=0.15, lw=0)
    for values, label, style in (
        (batch.truth[:, 0, state], "state", {"color": TRUE, "lw": 1.6, "zorder": 3}),
        (mean, "estimate, recommended (± 2 sigma)",
         {"color": OURS, "lw": 1.6, "ls": "--", "zorder": 4}),
        (printed.mean[:, 0, state], "estimate, paper-literal", {"color": PRINTED, "lw": 1}),
    ):  # fmt: skip
        axes.plot(steps, values, label=label, **style)
    axes.set(xlabel="step s", ylabel=f"$x_{state + 1}$", xlim=(0, steps[-1]))
    axes.legend(frameon=False, loc="upper right")
    return figure


def _errors(batch: MeasuredBatch, recommended: SlotEstimates, printed: SlotEstimates) -> Figure:
    figure, axes = one_axes(4.2)
    steps = np.arange(len(batch.truth))
    for outcome, colour, name in (
        (printed, PRINTED, "paper-literal"),
        (recommended, OURS, "recommended"),
    ):
        mse, trace = mse_by_step(batch, outcome), trace_by_step(outcome)
        axes.semilogy(steps[1:], mse[1:], color=colour, lw=1.6, label=f"MSE, {name}")
        label = f"tr P, {name}: the filter's estimate of it, no bound"
        axes.semilogy(steps[1:], trace[1:], color=colour, lw=1.2, ls=":", label=label)
    running = running_mse(batch, recommended)
    axes.semilogy(
        steps[1:], running, color=TRUE, lw=1.0, ls="--",
        label="running MSE of run 0, recommended: the printed formula",
    )  # fmt: skip
    axes.set(xlabel="step s", ylabel="MSE and tr P (log scale)", xlim=(0, steps[-1]))
    axes.legend(frameon=False, loc="upper right")
    return figure


def _access(outcome: SlotEstimates) -> Figure:
    figure, axes = one_axes(3.0)
    sent = outcome.sent[:, 0]
    for sensors, colour, label in (
        (range(meng2025.STATIC_SLOTS), OURS, "static slot (round robin)"),
        (range(meng2025.STATIC_SLOTS, sent.shape[-1]), DYNAMIC, "dynamic slot (contended for)"),
    ):
        slot, place = np.nonzero(sent[:, list(sensors)])
        axes.plot(slot + 1, place + sensors[0] + 1, "s", ms=4, color=colour, label=label)
    sensors = sent.shape[-1]
    axes.set(xlabel="step s", ylabel="sensor", xlim=(0, len(sent) + 1))
    axes.set(ylim=(0.4, sensors + 0.6), yticks=range(1, sensors + 1))
    axes.grid(axis="y", color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure
