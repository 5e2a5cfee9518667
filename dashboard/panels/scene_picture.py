"""The picture of the scene to take away: with its background, title, time, legend and scale."""

import io
from typing import Any

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import PlantDrawing
from concord.dashboard.scene.legend import meanings
from concord.dashboard.scene.scene import cell_m, is_to_scale
from concord.dashboard.theme import css
from concord.dashboard.view import View

# The ground that three.js shows behind the scene.
_GROUND = {True: (20, 20, 20), False: (255, 255, 255)}
_DPI, _MARGIN = 100, 14
# The legend lies below the scene, in columns.
_ROW, _COLUMN = 19, 380
LEAST_WIDTH = 1600
"""Pixels in which all columns of the legend find room."""


def scene_picture(pixels: np.ndarray, view: View, frame: StepFrame) -> bytes:
    """Return a PNG of a scene rendered as pixels (H, W, 3 or 4) with a transparent ground."""
    # Loading matplotlib takes longer than the picture.
    from matplotlib.figure import Figure

    theme, stage = view.theme, frame.stage
    seen, width = pixels.shape[:2]
    marks = meanings(view, frame)
    rows = -(-len(marks) // max(1, (width - 2 * _MARGIN) // _COLUMN))
    height = seen + _ROW * rows + 2 * _MARGIN
    figure = Figure((width / _DPI, height / _DPI), dpi=_DPI, facecolor=css(_GROUND[theme.dark]))
    figure.figimage(_on_ground(pixels, _GROUND[theme.dark]), yo=height - seen, resize=False)
    scenario = stage.setup.scenario

    def write(x: float, y: float, text: str, **how: Any) -> None:
        figure.text(x / width, 1 - y / height, text, **{"color": css(theme.text), **how})

    title = f"{scenario.name}: {stage.nodes} nodes, {scenario.rule.name}, seed {scenario.seed}"
    write(_MARGIN, _MARGIN + 14, title, fontsize=13, weight="bold")
    told = f"step {frame.step}, time {frame.time_s:.4g} s, {scale_words(view, frame)}"
    write(_MARGIN, _MARGIN + 34, told, fontsize=10)
    for place, (sign, colour, words) in enumerate(marks):
        column, row = divmod(place, rows)
        x, y = _MARGIN + _COLUMN * column, seen + _MARGIN + _ROW * (row + 0.7)
        write(x, y, sign, fontsize=10, color=css(colour))
        write(x + 20, y, words, fontsize=8.5)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def scale_words(view: View, frame: StepFrame) -> str:
    """Return the scale of a scene in words: its grid, and how much larger errors are drawn."""
    stage = frame.stage
    if not is_to_scale(stage):
        return "not to scale"
    factor = f", errors \u00d7 {view.magnify:g}" if stage.picture is PlantDrawing.PLANE else ""
    return f"grid {cell_m(stage):g} m{factor}"


def _on_ground(pixels: np.ndarray, ground: tuple[int, int, int]) -> np.ndarray:
    """Return opaque pixels (H, W, 3) as bytes."""
    if pixels.shape[-1] == 3:
        return pixels
    share = pixels[..., 3:] / 255
    mixed = share * pixels[..., :3] + (1 - share) * np.array(ground)
    return mixed.round().astype(np.uint8)
