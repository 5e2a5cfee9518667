"""Draw the pictures of the README and of sweeps from runs: `make pictures`."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from concord import plots, sweep
from concord.results.palette import save, use_house_style
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup

# Okabe and Ito's colours, which most people can tell apart.
SKY, ORANGE, GREEN, PINK, GREY = "#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#999999"


def draw_map(axes: Axes, setup: Setup, trace: Trace) -> None:
    """Draw nodes and links, the target's path, and each node's belief at a few instants."""
    positions = definition_of(setup.scenario).plant(setup.scenario).positions(0)
    assert positions is not None
    links = [
        (positions[i], positions[j]) for i, heard in enumerate(setup.neighbours) for j in heard
    ]
    axes.add_collection(LineCollection(links, colors=GREY, linewidths=0.6, alpha=0.6))
    axes.scatter(*positions.T, s=60, color=SKY, zorder=3, label="sensor nodes and their links")
    axes.plot(*trace.truth[:, [0, 2]].T, color="black", linewidth=1.5, label="target")
    for step in range(20, trace.steps, 10):
        axes.scatter(
            *trace.mean[step][:, [0, 2]].T,
            s=8,
            color=PINK,
            zorder=4,
            label="the nodes' estimates, every 10 s" if step == 20 else None,
        )
    axes.set(xlabel="east [m]", ylabel="north [m]", xlim=(-20, 1020), ylim=(-20, 1020))
    axes.set_aspect("equal")
    # Below the map: nodes are everywhere on it.
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize=8, frameon=False)


def draw_errors(axes: Axes, setup: Setup, trace: Trace) -> None:
    """Draw each node's position error over time beside the filter that hears everything."""
    truth = trace.truth[:, None, [0, 2]]
    errors = np.linalg.norm(trace.mean[..., [0, 2]] - truth, axis=-1)
    central = centralised(setup, trace.readings, trace.control).mean[:, [0, 2]] - truth[:, 0]
    axes.plot(errors, color=PINK, linewidth=0.5, alpha=0.5)
    axes.plot(np.sqrt((errors**2).mean(1)), color=ORANGE, label="network (root mean square)")
    axes.plot(np.linalg.norm(central, axis=-1), color=GREEN, label="one filter that hears all")
    axes.set(xlabel="time [s]", ylabel="position error [m]", yscale="log", xlim=(0, trace.steps))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize=8, frameon=False)


def draw_sweep() -> None:
    """Draw the effect of occupancy on three rules on three graphs: docs/sweep.png."""
    use_house_style()
    swept = sweep(
        "target-tracking",
        nodes=20,
        graph=["geometric", "ring", "complete"],
        rule=["ci", "wac", "hcmci"],
        number="float64",
        occupancy=[1.0, 0.5, 0.25, 0.1],
        runs=50,
    )
    save(plots(swept)["error-against"], Path(__file__).parent / "sweep.png")


def main() -> None:
    """Write docs/network.png and docs/sweep.png."""
    setup = prepare(scenario_of(nodes=20, rule="ci", number="float64", schedule="full", seed=7))
    trace = read_trace(setup, in_memory(setup))
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.5), layout="constrained")
    draw_map(left, setup, trace)
    draw_errors(right, setup, trace)
    figure.savefig(Path(__file__).parent / "network.png", dpi=110)
    draw_sweep()


if __name__ == "__main__":
    main()
