"""A car on its track, and the way that each of its sensors believes it to go."""

from collections.abc import Callable, Sequence

import numpy as np
import viser

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import SCENE_WIDTH, Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import add_lines, paint
from concord.dashboard.view import View


class CarTrack:
    """A car on its track: the way it went, the way each node believes, the network above the car.

    The way is dead reckoning from speed, heading and side slip; for a node, from its estimates.
    """

    _ABOVE, _SPREAD = 3.0, 0.16

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._stage = stage
        names = stage.state_names
        self._states = [names.index(name) for name in ("speed", "heading", "side slip")]
        self._truth_way = add_lines(scene, "/plant/truth_trail", 4.0)
        self._node_ways = add_lines(scene, "/plant/node_trails", 1.6)
        self._stems = add_lines(scene, "/plant/stems", 1.0)
        self._car = scene.add_box("/plant/car", dimensions=(0.95, 0.42, 0.22), visible=False)
        self._cabin = scene.add_box("/plant/cabin", dimensions=(0.45, 0.36, 0.18), visible=False)
        self._low_m, self._high_m = np.full(2, -5.0), np.full(2, 5.0)

    def _ways(self, past: Sequence[StepFrame]) -> tuple[np.ndarray, np.ndarray]:
        """Ways (T, 2) of the car and (T, N, 2) of the nodes' estimates, in metres."""
        truth = np.array([frame.truth[self._states] for frame in past])
        nodes = np.array([frame.belief.mean[:, self._states] for frame in past])
        step_s = self._stage.setup.time_step_s
        return _reckoned(truth, step_s), _reckoned(nodes, step_s)

    def _drawn(self, way: np.ndarray, height: float) -> np.ndarray:
        units = 0.8 * SCENE_WIDTH / (self._high_m - self._low_m).max()
        flat = (way - (self._low_m + self._high_m) / 2) * units
        return np.concatenate([flat, np.full((*flat.shape[:-1], 1), height)], axis=-1)

    def node_places(self, frame: StepFrame, past: Sequence[StepFrame]) -> np.ndarray:
        way, _ = self._ways(past)
        self._make_room(way[np.isfinite(way).all(-1)])
        car = self._drawn(np.nan_to_num(way[-1]), 0.0)
        around = self._stage.in_scene(self._stage.positions(0), self._ABOVE)
        return car + around * [self._SPREAD, self._SPREAD, 1.0]

    def _make_room(self, way: np.ndarray) -> None:
        """Let the picture hold a way (T, 2); it grows in leaps, so that it rests in between."""
        if not len(way):
            return
        low, high = way.min(axis=0), way.max(axis=0)
        leap = 0.4 * float((high - low).max())
        self._low_m = np.where(low < self._low_m, low - leap, self._low_m)
        self._high_m = np.where(high > self._high_m, high + leap, self._high_m)

    def extent(self) -> np.ndarray:
        wide, deep = 0.4 * SCENE_WIDTH, 0.15 * SCENE_WIDTH
        flat = [(x, y) for x in (-wide, wide) for y in (-deep, deep)]
        return np.array([(x, y, z) for x, y in flat for z in (0.0, self._ABOVE)])

    def target(self, frame: StepFrame) -> np.ndarray | None:
        return None

    def shown(self, view: View, frame: StepFrame) -> np.ndarray:
        return np.zeros((0, 3))

    def draw(self, view: View, frame: StepFrame, past: Sequence[StepFrame]) -> Callable[[], None]:
        theme = view.theme
        way, ways = self._ways(past)
        stride = max(1, len(past) // 400)
        kept = np.r_[0 : len(past) : stride, len(past) - 1]
        truth = geometry.path(self._drawn(way[kept], 0.05))
        nodes = [geometry.path(self._drawn(ways[kept, i], 0.03)) for i in range(self._stage.nodes)]
        colours = [
            theme.selection if i == view.selected else theme.estimate
            for i in range(self._stage.nodes)
        ]
        painted = np.repeat(np.array(colours), [len(segments) for segments in nodes], axis=0)
        segments = np.concatenate(nodes)
        finite = np.isfinite(segments).all((-1, -2))
        at = self.node_places(frame, past)
        car = self._drawn(np.nan_to_num(way[-1]), 0.12)
        stems = np.stack([at, np.broadcast_to(car, at.shape)], axis=1)
        heading = frame.truth[self._states[1]]
        known = bool(np.isfinite(heading))

        def assign() -> None:
            paint(self._truth_way, truth[np.isfinite(truth).all((-1, -2))], np.array(theme.truth))
            paint(self._node_ways, segments[finite], painted[finite][:, None])
            paint(self._stems, stems, np.array(theme.grid_section))
            for body, up in ((self._car, 0.0), (self._cabin, 0.18)):
                body.visible = known
                if known:
                    body.position = tuple(car + np.array([0.0, 0.0, up]))
                    body.wxyz = tuple(geometry.about_vertical(np.array(heading)))
                    body.color = theme.truth if up == 0.0 else theme.quiet

        return assign


def _reckoned(moving: np.ndarray, step_s: float) -> np.ndarray:
    """Places (T, ..., 2) of (speed, heading, side slip) (T, ..., 3), from the origin."""
    speed, course = moving[..., 0], moving[..., 1] + moving[..., 2]
    velocity = speed[..., None] * np.stack([np.cos(course), np.sin(course)], axis=-1)
    ways = np.cumsum(np.nan_to_num(velocity) * step_s, axis=0)
    return np.concatenate([np.zeros_like(ways[:1]), ways[:-1]], axis=0)
