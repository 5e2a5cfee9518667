"""A plant that has no place in space: its network, and at each node how wrong it is."""

from collections.abc import Callable, Sequence

import numpy as np
import viser

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import HIDDEN
from concord.dashboard.theme import linear
from concord.dashboard.view import View


class ErrorPosts:
    """A plant without a place: at each node a post as high as its error, a plate at 3 sigma."""

    _HEIGHT = 2.2

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._stage = stage
        n = stage.nodes
        self._width = float(np.clip(0.5 * np.sqrt(12 / n), 0.1, 0.4))
        turned = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        for_all = {
            "batched_wxyzs": turned,
            "batched_positions": np.zeros((n, 3)),
            "batched_scales": np.full((n, 3), HIDDEN),
            "batched_colors": np.full((n, 3), 128, np.uint8),
            "lod": "off",
        }
        post, plate = geometry.post(), geometry.ring(0.7)
        self._posts = scene.add_batched_meshes_simple(
            "/plant/errors", post[0].astype(np.float32), post[1], flat_shading=True, **for_all
        )
        self._plates = scene.add_batched_meshes_simple(
            "/plant/widths", plate[0].astype(np.float32), plate[1], side="double", **for_all
        )

    def node_places(self, frame: StepFrame, past: Sequence[StepFrame]) -> np.ndarray:
        return self._stage.in_scene(frame.stage.positions(frame.step), 0.15)

    def extent(self) -> np.ndarray:
        stage = self._stage
        heights = (0.0, self._HEIGHT)
        return np.concatenate([stage.in_scene(stage.whereabouts, height) for height in heights])

    def target(self, frame: StepFrame) -> np.ndarray | None:
        return None

    def shown(self, view: View, frame: StepFrame) -> np.ndarray:
        return np.zeros((0, 3))

    def draw(self, view: View, frame: StepFrame, past: Sequence[StepFrame]) -> Callable[[], None]:
        stage, theme = self._stage, view.theme
        error, width = frame.scores.error, frame.stage.deviations * frame.scores.width
        top = float(np.nanmax(width)) if np.isfinite(width).any() else 1.0
        units = self._HEIGHT / top if top > 0 else 1.0
        places = self.node_places(frame, past)
        known = np.isfinite(error) & np.isfinite(width)
        height = np.clip(np.nan_to_num(error) * units, HIDDEN, 2.5 * self._HEIGHT)
        scales = np.full((stage.nodes, 3), HIDDEN)
        scales[known] = np.stack(
            [np.full(stage.nodes, self._width), np.full(stage.nodes, self._width), height], axis=-1
        )[known]
        over = error > width
        colours = np.where(over[:, None], theme.down, theme.estimate)
        plates = places + np.stack([0 * width, 0 * width, np.nan_to_num(width) * units], axis=-1)
        plate_scales = np.where(known, 1.3 * self._width, HIDDEN)

        def assign() -> None:
            self._posts.batched_positions = places.astype(np.float32)
            self._posts.batched_scales = scales.astype(np.float32)
            self._posts.batched_colors = linear(colours)
            self._plates.batched_positions = plates.astype(np.float32)
            self._plates.batched_scales = np.repeat(plate_scales[:, None], 3, 1).astype(np.float32)
            self._plates.batched_colors = linear(np.tile(theme.fused, (stage.nodes, 1)))

        return assign
