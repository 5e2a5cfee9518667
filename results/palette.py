"""The look of every picture: colours that most people can tell apart, and room to read."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from concord.disk import writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito (2008), Color universal design; black last, yellow left out: too pale for a line.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY = "#777777"
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", "--", ":", "-.")
# Runs evenly from dark to light, also in grey and for the colour blind.
SEQUENTIAL = "cividis"
# Inches and points on paper.
_LEAST_HEIGHT, _LEAST_FONT = 2.4, 6.0


class Style(NamedTuple):
    """How one value of a field is drawn everywhere in a picture."""

    colour: str
    marker: str
    dash: str


def styles(values: Sequence[object]) -> dict[str, Style]:
    """A style for each value, by its text; marker and dash tell apart what colour does not."""
    return {
        str(value): Style(
            COLOURS[place % len(COLOURS)],
            MARKERS[place % len(MARKERS)],
            DASHES[place // len(COLOURS) % len(DASHES)],
        )
        for place, value in enumerate(values)
    }


def use_house_style(dots_per_inch: int = 130) -> None:
    """Set matplotlib up; nothing is drawn on a screen."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update(
        {
            "figure.dpi": 130,
            "savefig.dpi": dots_per_inch,
            "font.size": 9,
            "axes.titlesize": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.color": "#DDDDDD",
            "grid.linewidth": 0.6,
            "axes.axisbelow": True,
            "legend.frameon": False,
            "legend.handlelength": 1.4,
            "legend.handletextpad": 0.5,
            "legend.columnspacing": 1.2,
            "lines.linewidth": 1.5,
            "lines.markersize": 5,
            # Equal results give equal files.
            "svg.hashsalt": "concord",
        }
    )


def name_styles(axes: Any, colours: dict[str, Style], markers: dict[str, Style]) -> None:
    """Give the legend an entry for each colour and for each marker, where there are several."""
    for names, pick in ((colours, "colour"), (markers, "marker")):
        for name, style in names.items() if len(names) > 1 else ():
            axes.plot([], [], linestyle="", label=name,
                      color=style.colour if pick == "colour" else GREY,
                      marker="o" if pick == "colour" else style.marker)  # fmt: skip


def plain_numbers(axis: Any) -> None:
    """Ticks of a logarithmic axis at 1, 2 and 5 of each decade, written out."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
    axis.set_minor_formatter(NullFormatter())


def without_title(figure: "Figure") -> None:
    """Take the title of a figure away, and that of its only panel; several panels keep theirs."""
    figure.suptitle("").set_in_layout(False)
    if len(panels := [axes for axes in figure.axes if axes.get_subplotspec() is not None]) == 1:
        panels[0].set_title("", loc="left")
        panels[0].set_title("")


def fit_width(figure: "Figure", width: float) -> None:
    """Give a figure a width in inches; its text shrinks with it, as far as a reader can read it."""
    from matplotlib.text import Text

    ratio = width / figure.get_figwidth()
    figure.set_size_inches(width, max(figure.get_figheight() * ratio, _LEAST_HEIGHT))
    for found in figure.findobj(Text):
        assert isinstance(found, Text)
        size = float(found.get_fontsize())
        found.set_fontsize(min(size, max(_LEAST_FONT, size * ratio)))


def save(figure: "Figure", path: Path) -> None:
    """Write a figure in the format of the name's ending, without the date."""
    import matplotlib.pyplot as plt

    dateless = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with writing(path):
        figure.savefig(path, metadata=dateless.get(path.suffix[1:]))
    plt.close(figure)
