"""The picture of a design: what every candidate costs and how far off it is, and the front."""

from typing import TYPE_CHECKING, Any

import numpy as np

from concord.results.palette import GREY, name_styles, plain_numbers, styles
from concord.studies.design.candidates import COSTS
from concord.studies.design.results import Design, Tried
from concord.studies.sweep.specification import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def design_figures(design: Design) -> "dict[str, Figure]":
    """Return the front over what is spared, and over the bytes that it takes."""
    spared = {"front": _front(design, design.minimise)}
    return (
        spared if design.minimise == "bytes" else {**spared, "front-bytes": _front(design, "bytes")}
    )


def _front(design: Design, cost: Any) -> "Figure":
    import matplotlib.pyplot as plt

    def price(one: Tried) -> float:
        return one.costs[cost]

    figure, axes = plt.subplots(figsize=(7.2, 4.8), layout="constrained")
    colour = next((f for f in ("rule", "graph") if f in design.tried[0].values), None)
    marker = "graph" if colour == "rule" and "graph" in design.tried[0].values else None
    colours, markers = (
        styles(sorted({_name(one, field) for one in design.tried})) for field in (colour, marker)
    )
    for one in design.tried:
        axes.plot(price(one), one.error.value, linestyle="", alpha=0.9 if one.front else 0.3,
                  color=colours[_name(one, colour)].colour,
                  marker=markers[_name(one, marker)].marker)  # fmt: skip
    line = sorted((one for one in design.tried if one.front), key=price)
    _draw_line(axes, line, price)
    axes.axhline(design.target.most, color=GREY, linestyle="--", linewidth=1, label="target")
    if design.recommended is not None:
        _draw_recommended(axes, design, price)
    name_styles(axes, colours, markers)
    unit = design.unit if design.target.reference == "unit" else f"x {design.target.reference}"
    axes.set(xlabel=COSTS[cost].meaning, ylabel=f"RMSE, {unit}", xscale="log", yscale="log")
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)
    nodes = f", {design.settled['nodes']} nodes" if "nodes" in design.settled else ""
    axes.set_title(f"{design.scenario}{nodes}, seed {design.seed}: {len(design.tried)} candidates; "
                   "the line joins those that no other beats", loc="left")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=5)
    return figure


def _draw_line(axes: Any, line: list[Tried], price: Any) -> None:
    x = np.array([price(one) for one in line])
    y = np.array([one.error.value for one in line])
    # Only what is cheap enough for its error: a front over one cost is none over another.
    best = np.minimum.accumulate(y) == y
    bars = np.nan_to_num(np.abs([[e.value - e.low, e.high - e.value] for e in
                                 (one.error for one in line)])).T  # fmt: skip
    axes.step(x[best], y[best], where="post", color=GREY, linewidth=1, zorder=1)
    axes.errorbar(x, y, yerr=bars, linestyle="", color=GREY, capsize=2, linewidth=1, zorder=1)


def _draw_recommended(axes: Any, design: Design, price: Any) -> None:
    assert design.recommended is not None
    chosen = next(one for one in design.tried if one.values == design.recommended.values)
    axes.plot(price(chosen), design.recommended.error.value, linestyle="", marker="*",
              markersize=16, markerfacecolor="none", markeredgecolor="black",
              label="recommended, on fresh runs")  # fmt: skip


def _name(one: Tried, field: str | None) -> str:
    return "" if field is None else shown(one.values[field])
