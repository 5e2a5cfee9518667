"""What can be taken away: the scene as an animated page, charts, a picture, the run."""

import io
import zipfile
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
import viser

from dashboard.charts import Chart
from dashboard.conditions import sender_at
from dashboard.frame import Array, Frame
from dashboard.scene import Scene
from dashboard.scene_plants import TRAIL
from dashboard.stage import Stage
from dashboard.theme import Colour, css
from dashboard.view import View

MOST_FRAMES = 150
_FRAME_S = 0.08
_WIDTH, _HEIGHT = 900.0, 260.0


def animated_scene(stage: Stage, view: View, frames: Sequence[Frame], camera: "Camera") -> str:
    """The scene through `frames` as one page that needs nothing else.

    It is recorded on a server of its own: a recording takes down all that its server sends, and
    must not move the pictures of those who watch.
    """
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        server.initial_camera.position = camera.position
        server.initial_camera.look_at = camera.look_at
        scene = Scene(server.scene, stage, view.theme, None)
        recorder = server.get_scene_serializer()
        stride = max(1, -(-len(frames) // MOST_FRAMES))
        for index in range(0, len(frames), stride):
            past = frames[max(0, index + 1 - TRAIL) : index + 1]
            sender, _ = sender_at(frames[index], view.cursor)
            assign = scene.draw(view, frames[index], past, sender)
            with server.atomic():
                assign()
            recorder.insert_sleep(_FRAME_S)
        return recorder.as_html(dark_mode=view.theme.dark)
    finally:
        server.stop()


class Camera:
    """Where a scene is looked at from."""

    def __init__(self, position: tuple[float, float, float], look_at: tuple[float, float, float]):
        self.position, self.look_at = position, look_at


def charts_page(stage: Stage, charts: Sequence[Chart], view: View) -> str:
    """All charts as one page of SVG: no script, opens anywhere, prints well."""
    figures = "".join(_chart_svg(chart, view) for chart in charts if chart.rows)
    scenario = stage.setup.scenario
    title = escape(
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.rule}, seed {scenario.seed}"
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>'
        "<style>body{font:14px sans-serif;max-width:940px;margin:2em auto;color:#222}"
        f"h2{{font-size:15px;margin:1.4em 0 .2em}}</style><h1>{title}</h1>"
        f"<p>up to step {view.step}</p>{figures}</html>\n"
    )


def _chart_svg(chart: Chart, view: View) -> str:
    times, *columns = chart.rows
    numbers = np.concatenate([column[np.isfinite(column)] for column in columns])
    if not len(numbers):
        return ""
    low, high = min(0.0, float(numbers.min())), float(numbers.max())
    high = high if high > low else low + 1.0
    left, bottom = 60.0, 24.0
    x = left + (times - times[0]) / max(times[-1] - times[0], 1e-12) * (_WIDTH - left - 10)
    parts = []
    for tick in np.linspace(low, high, 5):
        y = _HEIGHT - bottom - (tick - low) / (high - low) * (_HEIGHT - bottom - 10)
        parts.append(
            f'<path d="M{left:g} {y:.1f}H{_WIDTH - 10:g}" stroke="#ddd"/><text x="{left - 6:g}" '
            f'y="{y + 4:.1f}" text-anchor="end" font-size="11">{tick:.3g}</text>'
        )
    for place in np.linspace(0, len(times) - 1, 7).astype(int):
        parts.append(
            f'<text x="{x[place]:.1f}" y="{_HEIGHT - 6:g}" text-anchor="middle" font-size="11">'
            f"{times[place]:.4g}</text>"
        )
    legend = []
    for name, colour, column in zip(chart.names, chart.colours, columns, strict=True):
        if not np.isfinite(column).any():
            continue
        ink = _on_paper(colour)
        y = _HEIGHT - bottom - (column - low) / (high - low) * (_HEIGHT - bottom - 10)
        parts.append(f'<path d="{_pen(x, y)}" fill="none" stroke="{ink}" stroke-width="1.6"/>')
        legend.append(f'<span style="color:{ink};margin-right:1.2em">— {escape(name)}</span>')
    return (
        f"<h2>{escape(chart.title)}</h2><svg viewBox='0 0 {_WIDTH:g} {_HEIGHT:g}' width='100%'>"
        f"{''.join(parts)}</svg><div>{''.join(legend)} time [s] →</div>"
    )


def _on_paper(colour: Colour) -> str:
    """A colour that can be seen on white."""
    bright = sum(colour) > 600
    return "#333333" if bright else css(colour)


def _pen(x: Array, y: Array) -> str:
    """A path through the finite points, lifted where there are none."""
    path, down = [], False
    for at, height in zip(x, y, strict=True):
        if not np.isfinite(height):
            down = False
            continue
        path.append(f"{'L' if down else 'M'}{at:.1f} {height:.1f}")
        down = True
    return "".join(path)


def screenshot(client: viser.ClientHandle) -> bytes:
    """The scene as the browser of this client shows it, as PNG."""
    height, width = client.camera.image_height, client.camera.image_width
    picture = client.get_render(height=height or 900, width=width or 1600, transport_format="png")
    # Loading matplotlib takes longer than the picture.
    from matplotlib.image import imsave

    buffer = io.BytesIO()
    imsave(buffer, picture, format="png")
    return buffer.getvalue()


def zipped(folder: Path) -> bytes:
    """The files of a run's folder in one archive.

    Raises:
        ValueError: the folder cannot be read.
    """
    buffer = io.BytesIO()
    try:
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(folder.iterdir()):
                if file.is_file():
                    archive.write(file, f"{folder.name}/{file.name}")
    except OSError as error:
        raise ValueError(f"{folder}: cannot be read ({error.strerror})") from None
    return buffer.getvalue()
