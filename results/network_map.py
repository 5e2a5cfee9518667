"""A map of a network whose nodes have the colour of their error."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from concord.results.palette import GREY, SEQUENTIAL
from concord.scenarios.catalogue import definition_of
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANEL = 3.6


class Mapped(NamedTuple):
    """A network to draw: its setup, the error of each node (N,), and what to call it."""

    setup: Setup
    error: np.ndarray
    title: str


def network_maps(networks: Sequence[Mapped], unit: str) -> "Figure":
    """One map beside the other, in one scale of colours."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    errors = np.concatenate([network.error for network in networks])
    low, high = np.nanmin(errors), np.nanmax(errors)
    scale = LogNorm(low, max(high, low * 1.01))
    figure, grid = plt.subplots(
        1, len(networks), figsize=(max(PANEL * len(networks), 5.0), PANEL + 1.4), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    marks = None
    for axes, network in zip(grid.flat, networks, strict=True):
        marks = _draw(axes, network, scale)
    assert marks is not None, "a map of nothing"
    bar = figure.colorbar(marks, ax=grid, orientation="horizontal", shrink=0.6, aspect=40)
    bar.set_label(f"error of the node [{unit}]; dark is worse")
    # Few decades: a logarithmic scale would name none of its ends.
    ticks = np.geomspace(low, max(high, low * 1.01), 4)
    bar.set_ticks(ticks.tolist(), labels=[f"{tick:.3g}" for tick in ticks])
    bar.ax.minorticks_off()
    return figure


def _draw(axes: Any, network: Mapped, scale: Any) -> Any:
    from matplotlib.collections import LineCollection

    setup = network.setup
    positions, unit = _positions(setup)
    links = [
        (positions[i], positions[j]) for i, heard in enumerate(setup.neighbours) for j in heard
    ]
    # Many links make a grey sheet unless each is faint.
    faint = float(np.clip(12 / np.sqrt(max(len(links), 1)), 0.15, 0.8))
    axes.add_collection(LineCollection(links, colors=GREY, linewidths=0.6, alpha=faint))
    definition = definition_of(setup.scenario)
    blind = np.array(
        [definition.sensor(setup.scenario, node) is None for node in range(len(positions))]
    )
    size = float(np.clip(1600 / len(positions), 8, 70))
    look = {"cmap": f"{SEQUENTIAL}_r", "norm": scale, "s": size, "zorder": 3,
            "edgecolors": "black", "linewidths": 0.5}  # fmt: skip
    marks = axes.scatter(*positions[~blind].T, c=network.error[~blind], **look)
    if blind.any():
        axes.scatter(
            *positions[blind].T, c=network.error[blind], marker="s", label="blind node", **look
        )
        axes.legend(loc="lower left")
    worst = int(np.nanargmax(network.error))
    axes.annotate(f"{worst}", positions[worst], xytext=(5, 5), textcoords="offset points")
    axes.set_title(network.title, loc="left", fontsize=8)
    axes.set_aspect("equal")
    axes.grid(visible=False)
    if unit:
        axes.set(xlabel=f"east [{unit}]", ylabel=f"north [{unit}]")
    else:
        axes.set(xticks=[], yticks=[])
    axes.margins(0.08)
    return marks


def _positions(setup: Setup) -> tuple[np.ndarray, str]:
    """Where the nodes are (N, 2), in m; without a unit where a drawing puts them."""
    positions = definition_of(setup.scenario).plant(setup.scenario).positions(0)
    if positions is not None:
        return positions[:, :2], "m"
    import networkx

    graph = networkx.Graph()
    graph.add_nodes_from(range(len(setup.neighbours)))
    graph.add_edges_from((i, j) for i, heard in enumerate(setup.neighbours) for j in heard)
    placed = networkx.kamada_kawai_layout(graph)
    return np.array([placed[node] for node in range(len(placed))]), ""
