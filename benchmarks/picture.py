"""Picture of the results of `make bench`, for the page on performance and the README.

python -m benchmarks.picture runs/bench.json docs/performance.png draws it again.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from benchmarks.compare import Kept
from benchmarks.measure import BenchmarkFigures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FiguresByCase = dict[str, BenchmarkFigures]

CASES = {
    "A": ("straight line, n = 4", "#2a6f97"),
    "B": ("turn by range and bearing, n = 5", "#e07a1f"),
}
FILTERS = {
    "Stone Soup": "Stone Soup",
    "filterpy": "filterpy",
    "numpy, one": "concord, one filter",
    "cuthbert": "cuthbert (JAX, extended), 10,000",
    "dynamax": "dynamax (JAX), 10,000",
    "numpy, many": "concord, 10,000 filters",
    "C loop": "loop in C, models in C",
}
# Label, benchmark, figure, and what the figure should be.
TIMES_AS_FAST = (
    ("fusion / Python loop", "fusion", "numpy, 1 round x loop", None),
    ("set membership, exact / solver", "set-membership", "exact x generic", None),
    ("set membership, closed form / solver", "set-membership", "fast x generic", None),
)
RATIOS = (
    ("five rounds of fusion / one", "fusion", "numpy, five rounds over one", 1.4),
    ("Monte Carlo / its filters", "monte-carlo", "numpy, end to end over kernels", 1.5),
    ("10,000 nodes / 100, per edge", "scale", "10000 over 100 nodes", 1.3),
    ("lockstep / bare loop, rate", "lockstep", "lockstep over bare", 0.8),
    ("with a page attached / without", "dashboard", "watched-to-alone", None),
)


class Growth(NamedTuple):
    """A figure over a size: names of figures are the size and `ending`; `slope` is the power."""

    bench: str
    ending: str
    size: str
    title: str
    slope: str | None


GROWTHS = (
    Growth("scale", " nodes, ns per edge", "nodes", "ns per edge", "slope over nodes"),
    Growth(
        "scale",
        " edges, ns per edge",
        "edges of 1,000 nodes",
        "ns per edge",
        "slope over edges",
    ),
    Growth("launch", " nodes ready s", "nodes", "processes: seconds until ready", None),
    Growth("launch", " nodes MB per node", "nodes", "processes: MB per node", None),
)
INK, GREY = "#2a6f97", "#6b6b6b"


def draw(results: FiguresByCase, path: Path) -> None:
    """Draw the measured results, one panel per question; missing results are left out."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(12.5, 7.2), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=(1.7, 1, 1), width_ratios=(1.25, 1, 1))
    if "ukf" in results:
        _draw_filters(figure.add_subplot(grid[0, :]), results["ukf"])
    _draw_ratios(figure.add_subplot(grid[1, 0]), results)
    _draw_times(figure.add_subplot(grid[2, 0]), results)
    for place, growth in zip(((1, 1), (1, 2), (2, 1), (2, 2)), GROWTHS, strict=True):
        _draw_growth(figure.add_subplot(grid[place]), results.get(growth.bench, {}), growth)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _draw_filters(axes: "Axes", ukf: BenchmarkFigures) -> None:
    """Steps per second of the UKF, both cases, on a logarithmic scale."""
    names = [name for name in FILTERS if f"A {name} us" in ukf]
    for place, (case, (title, colour)) in enumerate(CASES.items()):
        for row, name in enumerate(names):
            rate = 1e6 / ukf[f"{case} {name} us"].value
            height = row + 0.2 - 0.4 * place
            axes.barh(height, rate, 0.36, color=colour, label=None if row else title)
            text = f"{_in_short(ukf[f'{case} {name} x filterpy'].value)} x"
            axes.annotate(text, (rate, height), (4, 0), textcoords="offset points", va="center")
    axes.set_xscale("log")
    axes.set_xlim(300, 1e8)
    axes.set_yticks(range(len(names)), [FILTERS[name] for name in names])
    axes.set_title("UKF steps per second on one core (numbers: times filterpy)", fontsize=10)
    axes.legend(loc="lower right", frameon=False)
    _plain(axes)


def _draw_ratios(axes: "Axes", results: FiguresByCase) -> None:
    """Ratios of two times or rates beside what they should be."""
    _draw_bars(axes, results, RATIOS, lambda value: f"{value:.2f}")
    axes.set_xlim(0, 2.4)
    axes.set_title("ratios; black: the aim", fontsize=10)


def _draw_times(axes: "Axes", results: FiguresByCase) -> None:
    """How many times as fast as the plain way."""
    _draw_bars(axes, results, TIMES_AS_FAST, lambda value: f"{_in_short(value)} x")
    axes.set_xscale("log")
    axes.set_xlim(1, 1e5)
    axes.set_title("times as fast", fontsize=10)


def _draw_bars(
    axes: "Axes",
    results: FiguresByCase,
    bars: Sequence[tuple[str, str, str, float | None]],
    text: Callable[[float], str],
) -> None:
    """Medians, quartiles as lines, and aims; the text is right of them."""
    found = [
        (label, aim, figure)
        for label, bench, name, aim in bars
        if (figure := results.get(bench, {}).get(name)) is not None
    ]
    for row, (_, aim, figure) in enumerate(found):
        end = figure.high if aim is None else max(figure.high, aim)
        axes.barh(row, figure.value, 0.6, color=INK, alpha=0.75)
        axes.plot([figure.low, figure.high], [row, row], color=GREY)
        axes.annotate(
            text(figure.value), (end, row), (5, 0), textcoords="offset points", va="center"
        )
        if aim is not None:
            axes.plot([aim, aim], [row - 0.4, row + 0.4], color="black")
    axes.set_yticks(range(len(found)), [label for label, *_ in found])
    _plain(axes)


def _draw_growth(axes: "Axes", figures: BenchmarkFigures, growth: Growth) -> None:
    """A figure over a size on a logarithmic scale, with quartiles."""
    found = {
        int(name.removesuffix(growth.ending)): one
        for name, one in figures.items()
        if name.endswith(growth.ending)
    }
    sizes, values = list(found), [one.value for one in found.values()]
    axes.plot(sizes, values, "o-", color=INK)
    axes.vlines(
        sizes, [one.low for one in found.values()], [one.high for one in found.values()], color=GREY
    )
    for place, value in zip(sizes, values, strict=True):
        axes.annotate(
            f"{value:.3g}", (place, value), (0, 8), textcoords="offset points", ha="center"
        )
    axes.set_xscale("log")
    axes.set_xticks(sizes, [f"{place:,}" for place in sizes], fontsize=9)
    axes.minorticks_off()
    axes.margins(x=0.18)
    axes.set_ylim(0, 1.4 * max([one.high for one in found.values()], default=1))
    axes.set_xlabel(growth.size)
    slope = figures.get(growth.slope or "")
    power = "" if slope is None else f"; slope of the cost {slope.value:.2f}"
    axes.set_title(growth.title + power, fontsize=10)
    _plain(axes)


def _plain(axes: "Axes") -> None:
    axes.spines[["top", "right"]].set_visible(False)


def _in_short(times: float) -> str:
    return f"{times:,.0f}" if times >= 10 else f"{times:.1f}"


def main() -> None:
    """Draw what a file says that `make bench` kept."""
    kept, path = (Path(name) for name in sys.argv[1:3])
    draw(msgspec.json.decode(kept.read_bytes(), type=Kept).results, path)


if __name__ == "__main__":
    main()
