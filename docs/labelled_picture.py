"""Draw the picture of docs/labelled.md from a run: `make pictures`."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from concord.results.records.record_spread import RecordSpread
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup

# Okabe and Ito's colours, which most people can tell apart.
BLUE, SKY, ORANGE, YELLOW, RED = "#0072B2", "#56B4E9", "#E69F00", "#F0E442", "#D55E00"
GREY = "#999999"
DELAYS = ("in the same step", "1 step later", "2 steps later", "3 or more")
STEP, OLDEST = 60, 12


def draw_spread(
    axes: Axes, setup: Setup, trace: Trace, spread: RecordSpread, source: int, node: int
) -> None:
    """Draw the delay after which each node held the record of one source."""
    positions = definition_of(setup.scenario).plant(setup.scenario).positions(0)
    assert positions is not None
    links = [
        (positions[i], positions[j]) for i, heard in enumerate(setup.neighbours) for j in heard
    ]
    axes.add_collection(LineCollection(links, colors=GREY, linewidths=0.6, alpha=0.6))
    delay = np.minimum(spread.arrival_steps[:, STEP, source] - STEP, len(DELAYS) - 1)
    colours = (BLUE, SKY, YELLOW, ORANGE)
    for value, words in enumerate(DELAYS):
        axes.scatter(
            *positions[delay == value].T, s=90, color=colours[value], edgecolor="black",
            linewidth=0.5, zorder=3, label=words,
        )  # fmt: skip
    axes.scatter(
        *positions[source], s=260, marker="o", facecolor="none", edgecolor=RED, linewidth=2,
        zorder=4, label="who took it",
    )  # fmt: skip
    axes.annotate(f"node {node}", tuple(positions[node] + [22, -35]))
    axes.plot(*trace.truth[STEP, [0, 2]], marker="*", markersize=14, color="black", zorder=4)
    axes.annotate("target", tuple(trace.truth[STEP, [0, 2]] + [20, -45]))
    axes.set(xlabel="east [m]", ylabel="north [m]", xlim=(-20, 1020), ylim=(-20, 1020))
    axes.set_title("one record spreads: when each node has it")
    axes.set_aspect("equal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize=8, frameon=False)


def draw_window(axes: Axes, spread: RecordSpread, node: int) -> None:
    """Draw the records that a node holds at a step, and those that are still on their way."""
    steps = np.arange(STEP - OLDEST + 1, STEP + 1)
    arrival = spread.arrival_steps[node, steps]
    kind = np.where(spread.taken[steps], np.where((arrival >= 0) & (arrival <= STEP), 2, 1), 0)
    colours = ["#f2f2f2", ORANGE, BLUE]
    axes.pcolormesh(
        np.arange(-OLDEST + 0.5, 1.5), np.arange(kind.shape[1] + 1) - 0.5, kind.T,
        cmap=ListedColormap(colours), norm=BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3),
        edgecolor="white", linewidth=1,
    )  # fmt: skip
    axes.set(
        xlabel=f"steps ago (the window: {spread.window_steps}; all older is in its base)",
        ylabel="source",
        yticks=range(kind.shape[1]),
        xticks=range(-OLDEST + 2, 1, 2),
        xticklabels=[str(-age) for age in range(-OLDEST + 2, 1, 2)],
    )
    axes.tick_params(axis="y", labelsize=7)
    axes.set_title(f"the window of node {node}: what it filters")
    names = ("source saw nothing", "taken, still on its way", "held, counted once")
    axes.legend(
        handles=[Patch(color=c, label=name) for c, name in zip(colours, names, strict=True)],
        loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize=8, frameon=False,
    )  # fmt: skip


def main() -> None:
    """Write docs/labelled.png."""
    options = scenario_of(nodes=20, rule="labelled", occupancy=0.25, steps=STEP + 12)
    setup = prepare(options)
    trace = read_trace(setup, in_memory(setup))
    spread = trace.spread
    assert spread is not None
    delay = np.where(spread.arrival_steps >= 0, spread.arrival_steps, trace.steps)[:, STEP]
    delay[:, ~spread.taken[STEP]] = 0
    node, source = np.unravel_index(int(delay.argmax()), delay.shape)
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.8), layout="constrained")
    draw_spread(left, setup, trace, spread, int(source), int(node))
    draw_window(right, spread, int(node))
    figure.savefig(Path(__file__).parent / "labelled.png", dpi=110)


if __name__ == "__main__":
    main()
