"""Picture of the precision of a cluster's clocks, cycle by cycle."""

from pathlib import Path

import matplotlib

from concord.runtime.disk import writing

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np


def draw(spreads_us: np.ndarray, bound_us: float, out: Path) -> None:
    """Write a picture of the largest difference of two active nodes' clocks in each cycle.

    Args:
        spreads_us: (cycles,). bound_us: the assumed precision.
    """
    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.plot(np.arange(1, len(spreads_us) + 1), spreads_us, linewidth=0.7, label="reached")
    axes.axhline(bound_us, color="black", linestyle="--", label="assumed precision")
    axes.set(
        xscale="log",
        xlabel="communication cycle since the first collision avoidance symbol",
        ylabel="largest difference of two clocks (us)",
        ylim=(0, None),
    )
    axes.legend()
    with writing(out):
        figure.savefig(out)
    plt.close(figure)
