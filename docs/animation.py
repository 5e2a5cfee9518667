"""Draw the animated picture of the README from a run, docs/network.gif: `make pictures`.

Twenty nodes with half of the bus track a target. The picture shows the map, the beliefs of all
nodes near the target, and the errors.
"""

from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from PIL import Image

from concord.results.palette import plain_numbers, use_house_style
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised, local_only
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup

SKY, ORANGE, GREEN, PINK, GREY = "#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#AAAAAA"
STEPS, FRAME_MS, LAST_FRAME_MS = 72, 120, 2000
COLOURS = 48
PLACE = [0, 2]
ZOOM_M = 40.0


class Film(NamedTuple):
    """Numbers behind the frames.

    Attributes:
        trace: the run.
        fused, alone: places (steps, N, 2) of the beliefs of nodes that fuse, and of nodes alone.
        errors: colour and error (steps,) of each curve, a root mean square over nodes and 5 steps.
    """

    trace: Trace
    fused: np.ndarray
    alone: np.ndarray
    errors: dict[str, tuple[str, np.ndarray]]


def film_of(setup: Setup) -> Film:
    """Run the scenario, and the filters beside it."""
    trace = read_trace(setup, in_memory(setup))
    truth = trace.truth[:, None, PLACE]
    fused = trace.mean[..., PLACE]
    alone = local_only(setup, trace.readings, trace.control).mean[..., PLACE]
    central = centralised(setup, trace.readings, trace.control).mean[:, None, PLACE]

    def error(places: np.ndarray) -> np.ndarray:
        squared = ((places - truth) ** 2).sum(-1).mean(1)
        return np.sqrt([squared[max(0, step - 4) : step + 1].mean() for step in range(STEPS)])

    errors = {
        "each node alone": (GREY, error(alone)),
        "the network": (PINK, error(fused)),
        "one filter that hears all": (GREEN, error(central)),
    }
    return Film(trace, fused, alone, errors)


def draw_map(axes: Axes, setup: Setup, film: Film, step: int) -> None:
    """Draw the nodes, their links, who sends, the target, and the beliefs."""
    positions = definition_of(setup.scenario).plant(setup.scenario).positions(0)
    assert positions is not None
    links = [
        (positions[i], positions[j]) for i, heard in enumerate(setup.neighbours) for j in heard
    ]
    axes.add_collection(LineCollection(links, colors=GREY, linewidths=0.5, alpha=0.6))
    target = film.trace.truth[step, PLACE]
    reads = np.isfinite(film.trace.readings[step]).any(axis=(1, 2))
    sights = [(target, place) for place in positions[reads]]
    axes.add_collection(LineCollection(sights, colors=SKY, linewidths=1.2, alpha=0.8))
    sends = film.trace.published[step, -1]
    axes.scatter(*positions.T, s=42, c=np.where(sends, ORANGE, SKY), zorder=3)
    axes.plot(*film.trace.truth[: step + 1, PLACE].T, color="black", linewidth=1.2)
    axes.scatter(*film.alone[step].T, s=16, marker="x", color=GREY, zorder=4)
    axes.scatter(*film.fused[step].T, s=10, color=PINK, zorder=5)
    axes.plot(*target, marker="*", markersize=11, color="black", zorder=4)
    axes.set(title="nodes, links and target (orange: sends)", xlabel="east [m]")
    axes.set(xlim=(-30, 1030), ylim=(-30, 1030), aspect="equal", ylabel="north [m]")


def draw_beliefs(axes: Axes, film: Film, step: int) -> None:
    """Draw the beliefs of all nodes about the target's place, with two standard deviations."""
    covs = film.trace.cov[step][:, PLACE][:, :, PLACE]
    sizes, axes_of = np.linalg.eigh(covs)
    offsets = film.fused[step] - film.trace.truth[step, PLACE]
    angles = np.degrees(np.arctan2(axes_of[:, 1, 1], axes_of[:, 0, 1]))
    widths, heights = 4 * np.sqrt(sizes[:, 1]), 4 * np.sqrt(sizes[:, 0])
    axes.add_collection(
        EllipseCollection(
            widths,
            heights,
            angles,
            units="xy",
            offsets=offsets,
            transOffset=axes.transData,
            facecolors="none",
            edgecolors=PINK,
            linewidths=0.9,
        )
    )
    axes.scatter(*offsets.T, s=10, color=PINK, zorder=3)
    axes.scatter(
        *(film.alone[step] - film.trace.truth[step, PLACE]).T, s=16, marker="x", color=GREY
    )
    axes.plot(0, 0, marker="*", markersize=11, color="black", zorder=4)
    axes.set(title="what the nodes believe (2 sigma)", xlabel="from the target [m]")
    axes.set(xlim=(-ZOOM_M, ZOOM_M), ylim=(-ZOOM_M, ZOOM_M), aspect="equal")


def draw_errors(axes: Axes, film: Film, step: int) -> None:
    """Draw the errors up to a step."""
    for words, (colour, error) in film.errors.items():
        axes.plot(error[: step + 1], color=colour, label=words)
        axes.plot(step, error[step], marker="o", color=colour)
    axes.set(title="position error [m], over 5 s", xlabel="time [s]", yscale="log")
    axes.set(xlim=(0, STEPS), ylim=(0.5, 1000), box_aspect=1)
    plain_numbers(axes.yaxis)
    axes.legend(loc="upper left", fontsize=8)


def main() -> None:
    """Write docs/network.gif."""
    use_house_style()
    network = {"nodes": 20, "rule": "ci", "number": "float64", "schedule": "hybrid"}
    options = {**network, "seed": 7, "occupancy": 0.5, "steps": STEPS}
    setup = prepare(scenario_of(**options))
    film = film_of(setup)
    figure, panels = plt.subplots(1, 3, figsize=(11.5, 4.1), dpi=80, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    frames: list[Image.Image] = []
    for step in range(STEPS):
        for axes in panels:
            axes.clear()
        draw_map(panels[0], setup, film, step)
        draw_beliefs(panels[1], film, step)
        draw_errors(panels[2], film, step)
        canvas.draw()
        # Panels that move from frame to frame would distract, and cost bytes.
        figure.set_layout_engine("none")
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
    palette = frames[STEPS // 2].quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=2)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first.save(
        Path(__file__).parent / "network.gif", save_all=True, append_images=others, loop=0,
        duration=[FRAME_MS] * (STEPS - 1) + [LAST_FRAME_MS], optimize=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
