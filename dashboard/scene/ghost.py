"""Ghosts of another run in the scene: beliefs and trail of the same step, dashed."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import PlantDrawing, Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import add_lines, paint
from concord.dashboard.view import View

_NOTHING = np.zeros((0, 2, 3))
_HEIGHT = 0.14


class Ghost:
    """The fused belief of another run with its trail, and a cross at the belief of each node.

    A plant without a place has no ghost: the charts and the table have its errors.
    """

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._stage = stage
        self._trail: Any = add_lines(scene, "/ghost/trail", 2.4)
        self._rim: Any = add_lines(scene, "/ghost/fused", 2.4)
        self._beliefs: Any = add_lines(scene, "/ghost/beliefs", 1.8)

    def draw(
        self, view: View, shown: StepFrame, ghost: StepFrame | None, past: Sequence[StepFrame]
    ) -> Callable[[], None]:
        """Work out the picture of a step of both runs; return what assigns it.

        `past` are frames of the other run, ending with `ghost`. Errors are drawn as much larger as
        those of the shown run, about the same truth.
        """
        trail = rim = beliefs = _NOTHING
        stage, states = self._stage, list(self._stage.place)
        if ghost is not None and stage.picture is PlantDrawing.PLANE:
            truth = shown.truth[states]
            anchor = truth if np.isfinite(truth).all() else shown.fused.mean[states]
            fused = stage.in_scene(np.array([one.fused.mean[states] for one in past]), _HEIGHT)
            trail = geometry.path(fused[np.isfinite(fused).all(-1)])[::2]
            mean, cov = ghost.fused.mean[states], ghost.fused.cov[states][:, states]
            if np.isfinite(mean).all() and np.isfinite(cov).all():
                rim = self._outline(view, ghost, anchor + view.magnify * (mean - anchor), cov)
            means = anchor + view.magnify * (ghost.belief.mean[:, states] - anchor)
            beliefs = _crosses(stage.in_scene(means[np.isfinite(means).all(-1)], _HEIGHT))
        colour = np.array(view.theme.sending)

        def assign() -> None:
            paint(self._trail, trail, colour)
            paint(self._rim, rim, colour)
            paint(self._beliefs, beliefs, colour)

        return assign

    def _outline(
        self, view: View, ghost: StepFrame, mean: np.ndarray, cov: np.ndarray
    ) -> np.ndarray:
        """Return every other segment (S, 2, 3) of the ellipse of the fused belief."""
        half, angle = geometry.ellipse_axes(cov)
        half = view.magnify * ghost.stage.deviations * self._stage.scale * half
        rim = geometry.outlines(self._stage.in_scene(mean)[:2], half, angle)
        return np.concatenate([rim, np.full((*rim.shape[:2], 1), _HEIGHT)], axis=-1)[::2]


def _crosses(at: np.ndarray, size: float = 0.13) -> np.ndarray:
    """Return a cross (2, 2, 3) at each of the points (P, 3), all in one (2 P, 2, 3)."""
    arms = size * np.array([[[-1.0, -1, 0], [1, 1, 0]], [[-1, 1, 0], [1, -1, 0]]])
    return (at[:, None, None] + arms).reshape(-1, 2, 3)
