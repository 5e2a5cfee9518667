"""Fig. 7 of the consensus paper: root loci of the classical controllers, one picture of twelve."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from concord.features.control.transfer_functions import root_locus
from concord.papers.kit.figures import BLACK, BLUE, GREY, ORANGE, VERMILION, legend_below, save
from concord.papers.wac.figures import DPI
from concord.papers.wac.root_loci import Panel, figure_7

FILE = "fig07_root_loci"

# Windows (re low, re high, im low, im high) in 1/s that show where each locus is decided.
WINDOWS = {
    "a": (-1.5, 0.3, -0.5, 0.5),
    "b": (-4, 0.5, -2, 2),
    "c": (-60, 20, -60, 60),
    "d": (-120, 30, -80, 80),
    "e": (-6, 2, -8, 8),
    "f": (-120, 20, -60, 60),
    "g": (-1.5, 0.5, -3, 3),
    "h": (-25, 3, -20, 20),
    "i": (-15, 3, -15, 15),
    "j": (-15, 5, -10, 10),
    "k": (-15, 5, -10, 10),
    "l": (-15, 5, -10, 10),
}
GAINS = 4000

# Their gain is in N/m, so that 1 is no design; see concord.papers.wac.root_loci.
WITHOUT_DESIGN = ("c", "d", "e")


def draw(folder: Path) -> str:
    """Write the picture; returns its name."""
    figure = Figure(figsize=(14, 9.5), layout="constrained")
    grid = figure.subplots(3, 4)
    for axes, (letter, panel) in zip(grid.flat, figure_7().items(), strict=True):
        _locus(axes, panel, designed=letter not in WITHOUT_DESIGN)
        low, high, bottom, top = WINDOWS[letter]
        axes.set(xlim=(low, high), ylim=(bottom, top))
        axes.set_title(f"({letter}) {panel.title}", fontsize=11)
    for axes in grid[-1]:
        axes.set_xlabel("real part [1/s]")
    for axes in grid[:, 0]:
        axes.set_ylabel("imaginary part [rad/s]")
    legend_below(figure, grid[0, 0], ncols=5)
    return save(figure, folder, FILE, DPI)


def _locus(axes: Axes, panel: Panel, *, designed: bool) -> None:
    # Where branches meet, poles move with the root of the gain: that takes a fine grid.
    gains = np.geomspace(panel.gains[1], panel.gains[-1], GAINS)
    for number, branch in enumerate(root_locus(panel.loop, np.insert(gains, 0, 0.0)).T):
        label = "closed-loop poles as the gain grows" if number == 0 else None
        axes.plot(branch.real, branch.imag, color=BLUE, linewidth=1.8, label=label)
    _marks(axes, np.roots(panel.loop.denominator), "x", VERMILION, "open-loop poles")
    _marks(axes, np.roots(panel.loop.numerator), "o", BLACK, "open-loop zeros")
    if designed:
        poles = root_locus(panel.loop, np.array([0.0, 1.0]))[1]
        _marks(axes, poles, "D", ORANGE, "gain 1: the controller as designed")
    axes.axvline(0, color=GREY, linewidth=0.8, zorder=0)
    axes.axhline(0, color=GREY, linewidth=0.8, zorder=0)


def _marks(axes: Axes, points: np.ndarray, marker: str, colour: str, label: str) -> None:
    axes.plot(
        np.real(points), np.imag(points), marker, color=colour, markersize=7,
        markerfacecolor="none", markeredgewidth=1.6, label=label,
    )  # fmt: skip
