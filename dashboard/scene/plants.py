"""Plant in the scene, and the interface of every picture of a plant."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import viser

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.scene import geometry
from concord.dashboard.theme import Theme, linear
from concord.dashboard.view import View

TRAIL = 150
HIDDEN = 1e-4
_NO_LINE = np.zeros((1, 2, 3), dtype=np.float32)


class PlantPicture(Protocol):
    """How a plant is drawn."""

    def node_places(self, frame: StepFrame, past: Sequence[StepFrame]) -> np.ndarray:
        """Where the nodes are in the scene (N, 3)."""
        ...

    def extent(self) -> np.ndarray:
        """Points of the scene (P, 3) that a picture of the whole must show."""
        ...

    def target(self, frame: StepFrame) -> np.ndarray | None:
        """Where the target is in the scene (3,); None where it is unknown or has no place."""
        ...

    def shown(self, view: View, frame: StepFrame) -> np.ndarray:
        """Return the points of the scene (P, 3) at which truth and beliefs are drawn."""
        ...

    def draw(self, view: View, frame: StepFrame, past: Sequence[StepFrame]) -> Callable[[], None]:
        """Work out the picture; returns what assigns it. `past` ends with `frame`."""
        ...


def add_lines(scene: viser.SceneApi, name: str, thickness: float) -> Any:
    """Lines of so many pixels, none yet."""
    return scene.add_line_segments(
        name, _NO_LINE, np.zeros((1, 2, 3), np.uint8), thickness=thickness,
        thickness_units="screen", visible=False,
    )  # fmt: skip


def paint(handle: Any, segments: np.ndarray, colours: np.ndarray) -> None:
    """Assign segments (S, 2, 3) with their colours, up to (S, 2, 3); nothing hides the lines."""
    handle.visible = len(segments) > 0
    if len(segments):
        handle.points = segments.astype(np.float32)
        handle.colors = linear(np.broadcast_to(colours, (*segments.shape[:2], 3)))


def fading(
    points: np.ndarray, colour: tuple[int, int, int], theme: Theme
) -> tuple[np.ndarray, np.ndarray]:
    """A trail through points (P, 3): segments, and colours that come out of the background."""
    points = points[np.isfinite(points).all(-1)]
    if len(points) < 2:
        return np.zeros((0, 2, 3)), np.zeros((0, 2, 3))
    ground = (16, 16, 16) if theme.dark else (255, 255, 255)
    share = np.linspace(0.12, 1.0, len(points))[:, None]
    shades = share * np.array(colour) + (1 - share) * np.array(ground)
    return geometry.path(points), geometry.path(shades)
