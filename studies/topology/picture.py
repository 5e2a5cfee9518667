"""The picture of `concord topology show`: the graph with its weights, its spectrum beside it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

from concord.disk import writing

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import networkx
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from concord.studies.topology.convergence import predicted_factor
from concord.studies.topology.subject import Subject
from concord.topology.adjacency import degrees, is_symmetric, links_of, nodes_of
from concord.topology.analysis import cut_nodes
from concord.topology.spectrum import DENSE_NODES, eigenvalues

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SUFFIXES = (".png", ".svg", ".pdf")
# Okabe and Ito's colours, which most people can tell apart.
_SKY, _ORANGE, _BLUE, _GREY = "#56B4E9", "#E69F00", "#0072B2", "#666666"
_MOST_NODES = 2000
_MOST_NAMES = 80


def draw(subject: Subject, out: Path, layout: str) -> dict[str, Any]:
    """Write the picture; says how many nodes it has and where they are drawn.

    Raises:
        ValueError: for a file that cannot be a picture, or a graph that cannot be drawn.
    """
    nodes = nodes_of(subject.weights)
    if out.suffix.lower() not in SUFFIXES:
        raise ValueError(f"--out {out}: a picture ends in {', '.join(SUFFIXES)}; rename it")
    if not out.parent.is_dir():
        raise ValueError(f"--out {out}: no such folder {out.parent}; make it first")
    if nodes > _MOST_NODES:
        raise ValueError(
            f"a picture of {nodes} nodes shows nothing; draw at most {_MOST_NODES}, or use "
            "`concord topology analyse`"
        )
    places, placed = _places(subject, layout)
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 5.6), layout="constrained", width_ratios=(1.45, 1)
    )
    _draw_graph(left, subject, places, placed)
    _draw_spectrum(right, subject)
    title = f"{_short(subject.name)}: {nodes} nodes, weights {subject.weights_name}"
    figure.suptitle(title + ("" if subject.links == "static" else f", links {subject.links}"))
    with writing(out):
        figure.savefig(out, dpi=130)
    plt.close(figure)
    return {"file": str(out), "nodes": nodes, "placed": placed}


def _places(subject: Subject, layout: str) -> tuple[np.ndarray, str]:
    """Where to draw the nodes (n, 2), and what that is."""
    own, nodes = subject.network.positions, nodes_of(subject.weights)
    if layout == "places" and own is None:
        raise ValueError(f"--layout places: graph {subject.name} has none; use auto")
    if own is not None and layout in ("auto", "places"):
        return own, "at their places"
    angle = np.pi / 2 - 2 * np.pi * np.arange(nodes) / nodes
    around = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    kind = subject.name.partition(":")[0]
    if layout == "circle" or (layout == "auto" and kind in ("ring", "complete", "small-world")):
        return around, "on a circle"
    graph = networkx.Graph(list(zip(*links_of(subject.network.adjacency), strict=True)))
    graph.add_nodes_from(range(nodes))
    start = dict(enumerate(around))
    laid = (
        networkx.kamada_kawai_layout(graph, pos=start)
        if nodes <= 120 and networkx.is_connected(graph)
        else networkx.spring_layout(graph, pos=start, iterations=80, seed=1)
    )
    return np.array([laid[node] for node in range(nodes)]), "laid out"


def _draw_graph(axes: "Axes", subject: Subject, places: np.ndarray, placed: str) -> None:
    adjacency, weights = subject.network.adjacency, subject.weights
    hearer, heard = links_of(adjacency)
    weight = np.asarray(weights[hearer, heard]).ravel() if len(hearer) else np.zeros(0)
    symmetric = is_symmetric(adjacency)
    back = np.zeros(len(hearer), bool) if not len(hearer) else _goes_back(subject)
    widest = max(float(weight.max(initial=0.0)), 1e-12)
    # Many links would paint the page: they are drawn finer.
    finest = float(np.clip(np.sqrt(150 / max(len(hearer), 1)), 0.35, 1))
    width = finest * (0.3 + 2.7 * weight / widest)
    delivery = subject.network.delivery if subject.plan.kind == "measured" else None
    strength = np.full(len(hearer), 0.55) if delivery is None else 0.12 + 0.88 * delivery
    for one_way, colour in ((True, _ORANGE), (False, _GREY)):
        chosen = np.flatnonzero(back != one_way)
        # The links that deliver best are drawn on top.
        chosen = chosen[np.argsort(strength[chosen], kind="stable")]
        lines = np.stack((places[heard[chosen]], places[hearer[chosen]]), axis=1)
        colours = [to_rgba(colour, float(strength[k])) for k in chosen]
        axes.add_collection(LineCollection(list(lines), colors=colours, linewidths=width[chosen]))
    nodes = len(places)
    size = float(np.clip(5000 / nodes, 8, 170))
    cut = np.isin(np.arange(nodes), cut_nodes(adjacency))
    for chosen, colour, marker in ((~cut, _SKY, "o"), (cut, _BLUE, "s")):
        axes.scatter(
            *places[chosen].T, s=size, color=colour, marker=marker, zorder=3,
            edgecolor="black", linewidth=0.5,
        )  # fmt: skip
    if nodes <= _MOST_NAMES:
        names = subject.network.names or tuple(map(str, range(nodes)))
        for name, place, is_cut in zip(names, places, cut, strict=True):
            axes.annotate(
                name, place, ha="center", va="center", zorder=4,
                fontsize=float(np.clip(60 / np.sqrt(nodes), 5, 9)),
                color="white" if is_cut else "black",
            )  # fmt: skip
    axes.set_aspect("equal")
    axes.margins(0.06)
    if placed == "at their places":
        unit = " [m]" if _in_metres(subject) else ""
        axes.set(xlabel=f"x{unit}", ylabel=f"y{unit}")
    else:
        axes.set_axis_off()
    _legend(axes, symmetric, bool(cut.any()), delivery is not None, float(weight.max(initial=0.0)))


def _goes_back(subject: Subject) -> np.ndarray:
    """Which links (links,) have one the other way."""
    adjacency = subject.network.adjacency
    hearer, heard = links_of(adjacency)
    return np.asarray(adjacency[heard, hearer]).ravel()


def _in_metres(subject: Subject) -> bool:
    return subject.setup is not None or subject.network.names is not None


def _legend(axes: "Axes", symmetric: bool, cut: bool, lossy: bool, widest: float) -> None:
    parts: list[Line2D] = [
        Line2D([], [], color=_GREY, linewidth=3, label=f"link, wide by weight (≤ {widest:.2g})")
    ]
    if not symmetric:
        parts.append(Line2D([], [], color=_ORANGE, linewidth=3, label="link that goes one way"))
    if lossy:
        parts.append(Line2D([], [], color=_GREY, alpha=0.25, linewidth=3, label="pale: loses more"))
    if cut:
        parts.append(
            Line2D([], [], color=_BLUE, marker="s", linestyle="", label="cut node: divides if lost")
        )
    axes.legend(
        handles=parts, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, fontsize=8,
        frameon=False,
    )  # fmt: skip


def _draw_spectrum(axes: "Axes", subject: Subject) -> None:
    if nodes_of(subject.weights) > DENSE_NODES:
        degree = degrees(subject.network.adjacency)
        axes.hist(degree, bins=min(40, int(np.ptp(degree)) + 1), color=_SKY, edgecolor="black")
        axes.set(xlabel="nodes heard", ylabel="nodes", title="degrees")
        return
    values = eigenvalues(subject.weights)
    moduli = np.abs(values)
    second = moduli[1] if len(moduli) > 1 else 0.0
    order = np.arange(1, len(moduli) + 1)
    axes.vlines(order, 0, moduli, color=_GREY, linewidth=0.6)
    axes.scatter(order, moduli, s=18, color=_SKY, edgecolor="black", linewidth=0.4, zorder=3)
    axes.axhline(second, color=_BLUE, linewidth=1)
    axes.text(
        len(order), second + 0.012, f"second: {second:.4g}, gap {1 - second:.3g}",
        ha="right", va="bottom", color=_BLUE, fontsize=9,
    )  # fmt: skip
    if subject.links != "static":
        _, factor = predicted_factor(subject)
        if factor is not None:
            axes.axhline(factor, color=_ORANGE, linewidth=1.4, linestyle="--")
            axes.text(
                len(order), factor - 0.012, f"with these links: {factor:.4g}",
                ha="right", va="top", color="#A06A00", fontsize=9,
            )  # fmt: skip
    axes.set(xlabel="eigenvalue of W, by modulus", ylabel="modulus: what a round leaves")
    axes.set_ylim(0, 1.08)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.spines[["top", "right"]].set_visible(False)


def _short(name: str) -> str:
    kind, colon, path = name.partition(":")
    return f"{kind} {Path(path).name}" if colon else (Path(name).name if "/" in name else name)
