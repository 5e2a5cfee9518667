"""Exports: the scene as an animated page, a picture of it, the run."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import viser

from concord.dashboard.frames.conditions import sender_at
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Drawn
from concord.dashboard.panels.scene_picture import LEAST_WIDTH, scene_picture
from concord.dashboard.panels.shared_run import FRAME_S, shared_run
from concord.dashboard.scene.camera import Camera, Free
from concord.dashboard.scene.plants import TRAIL
from concord.dashboard.scene.scene import Scene
from concord.dashboard.view import View

MOST_FRAMES = 150


def animated_scene(
    stage: Stage,
    view: View,
    frames: Sequence[StepFrame],
    camera: Camera,
    charts: Sequence[Drawn] = (),
) -> str:
    """Return scene, bus and charts through `frames` as one page that needs nothing else.

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
        shown = [
            frames[max(0, index + 1 - TRAIL) : index + 1] for index in range(0, len(frames), stride)
        ]
        for past in shown:
            sender, _ = sender_at(past[-1], view.cursor)
            assign = scene.draw(view, past[-1], past, sender)
            with server.atomic():
                assign()
            recorder.insert_sleep(FRAME_S)
        html = recorder.as_html(dark_mode=view.theme.dark)
        return shared_run(html, stage, view, shown, charts)
    finally:
        server.stop()


def screenshot(
    client: viser.ClientHandle, view: View, frame: StepFrame, free: Free | None
) -> bytes:
    """Return the scene as the browser of this client shows it, with its legend, as PNG.

    The part under the panels below the scene is cut off.
    """
    shape = (client.camera.image_height or 900) / (client.camera.image_width or 1600)
    width = max(client.camera.image_width or 0, LEAST_WIDTH)
    picture = client.get_render(height=round(shape * width), width=width, transport_format="png")
    rows = len(picture) if free is None else round(len(picture) * free.bottom / free.height)
    return scene_picture(picture[:rows], view, frame)


def zipped(folder: Path) -> bytes:
    """Return the files of a run's folder in one archive.

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
