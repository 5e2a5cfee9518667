"""Picture of innovations: NIS over time, and NIS and mean of each channel by node."""

from typing import TYPE_CHECKING, Any

import numpy as np

from concord.results.figures.intervals import chi_square_quantile
from concord.results.innovations.figures import nis_per_step
from concord.results.palette import COLOURS, GREY
from concord.scenarios.innovations import Innovations

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

_CENTRALISED = "centralised_"
_CONFIDENCE = 0.95


def innovation_figure(data: "xarray.Dataset", first: int, title: str) -> "Figure":
    """NIS of all nodes over time; and from step `first` on, for each node and channel, NIS and the
    mean innovation in standard deviations.

    `data` are the arrays of R runs with their innovations. Channels are those of the filter that
    hears everything where the file has it, else those of the nodes.
    """
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    own = _read(data, "")
    heard = _read(data, _CENTRALISED) if f"{_CENTRALISED}nis" in data else None
    figure, (over_time, squares, means) = plt.subplots(
        3, 1, figsize=(6.6, 7.2), layout="constrained", height_ratios=(1.3, 1, 1)
    )
    _over_time(over_time, data["time"].to_numpy(), own, heard)
    judged = own if heard is None else heard
    _by_node(squares, means, Innovations(*(values[:, first:] for values in judged)))
    for axes in (squares, means):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    over_time.set_title(title, loc="left")
    of = "nodes" if heard is None else "filter that hears everything"
    squares.set_title(f"channels of the {of}, {_CONFIDENCE:.0%} intervals", loc="left")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def _read(data: "xarray.Dataset", prefix: str) -> Innovations:
    """Innovations (R, S, N, r, m) of a data set."""
    names = (f"{prefix}innovation", f"{prefix}innovation_cov", f"{prefix}nis")
    return Innovations(*(data[name].to_numpy() for name in names))


def _over_time(axes: Any, time: np.ndarray, own: Innovations, heard: Innovations | None) -> None:
    """NIS per degree of freedom in each step, and where the mean of all runs is expected."""
    freedoms = own.entries.sum(axis=(0, 2, 3))
    there = freedoms > 0
    tails = ((1 - _CONFIDENCE) / 2, (1 + _CONFIDENCE) / 2)
    counts = np.maximum(freedoms, 1)
    limits = (chi_square_quantile(tail, counts) / counts for tail in tails)
    low, high = (np.where(there, limit, np.nan) for limit in limits)
    axes.fill_between(time, low, high, color=GREY, alpha=0.2, linewidth=0,
                      label="19 of 20, if independent")  # fmt: skip
    lines = [(own, COLOURS[0], "-", "nodes")]
    if heard is not None:
        lines.append((heard, COLOURS[1], "--", "one filter that hears everything"))
    for found, colour, dash, label in lines:
        per_step = nis_per_step(found)
        known = np.isfinite(per_step).any(axis=0)
        mean = np.full(len(time), np.nan)
        mean[known] = np.nanmean(per_step[:, known], axis=0)
        axes.plot(time[known], mean[known], dash, color=colour, label=label)
    axes.axhline(1, color=GREY, linestyle="--", linewidth=1)
    axes.set(yscale="log", xlabel="time [s]", ylabel="NIS, 1 is right")


def _by_node(squares: Any, means: Any, found: Innovations) -> None:
    """NIS and mean of each channel of each node."""
    variances = np.diagonal(found.cov, axis1=-2, axis2=-1)
    normalised = found.value / np.sqrt(variances)
    entries = normalised.shape[-1]
    for entry in range(entries):
        values = normalised[..., entry]
        counts = np.isfinite(values).sum(axis=(0, 1, 3))
        nodes = np.flatnonzero(counts)
        counts = counts[nodes]
        total = np.nansum(values**2, axis=(0, 1, 3))[nodes]
        mean = np.nansum(values, axis=(0, 1, 3))[nodes] / counts
        places = nodes + 0.6 * ((entry + 0.5) / entries - 0.5)
        low, high = (total / chi_square_quantile(tail, counts) for tail in (0.975, 0.025))
        style: dict[str, Any] = {"fmt": "o", "markersize": 3, "color": COLOURS[2 + entry % 5]}
        bars = np.stack([total / counts - low, high - total / counts])
        squares.errorbar(places, total / counts, bars, label=f"channel {entry}", **style)
        means.errorbar(places, mean, 1.96 / np.sqrt(counts), **style)
    squares.axhline(1, color=GREY, linestyle="--", linewidth=1)
    means.axhline(0, color=GREY, linestyle="--", linewidth=1)
    squares.set(yscale="log", ylabel="NIS, 1 is right")
    means.set(xlabel="node", ylabel="mean [std]")
