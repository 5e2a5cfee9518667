"""Innovations in tables."""

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from concord.results.innovations.figures import ChannelFigures, InnovationFigures, NisFigures


def nis_columns(figures: NisFigures) -> tuple[str, str, str]:
    """NIS, its interval, and the number of readings as cells of a table."""
    interval = figures.interval
    shown = "-" if interval is None else f"{interval[0]:.2g} to {interval[1]:.2g}"
    return short(figures.nis), shown, str(figures.updates)


def channel_table(figures: InnovationFigures) -> Table:
    """One row per channel, as the filter that hears everything sees it."""
    title = "innovations of the filter that hears everything"
    grid = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    grid.add_column("channel", no_wrap=True)
    for heading in ("taken", "NIS", "mean, 95 %", "lag 1"):
        grid.add_column(heading, justify="right", no_wrap=True)
    for one in figures.channels:
        grid.add_row(
            Text(f"{one.node}: {one.name}{f' [{one.unit}]' if one.unit else ''}"),
            str(one.updates), short(one.nis), _mean(one),
            "-" if one.correlation is None else f"{one.correlation:.2f}",
        )  # fmt: skip
    return grid


def _mean(one: ChannelFigures) -> str:
    if one.mean_interval is None:
        return _two(one.mean)
    return f"{_two(one.mean)} ± {(one.mean_interval[1] - one.mean_interval[0]) / 2:.2g}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def short(value: float | None) -> str:
    """A figure, or a dash."""
    return "-" if value is None or np.isnan(value) else f"{value:.3g}"
