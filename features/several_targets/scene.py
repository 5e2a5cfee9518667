"""Several targets among the nodes, and the tracks of one node in colours by identity."""

import colorsys
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import add_lines, fading, paint
from concord.dashboard.theme import Colour
from concord.dashboard.view import View
from concord.features.several_targets.frames import NodeTracks
from concord.features.several_targets.scanned_swarm import PLACES

_NOTHING = np.zeros((0, 2, 3))
_GOLDEN = 0.618034
_ARM, _RIM = 0.22, 24


def track_colour(number: int, is_dark: bool) -> Colour:
    """Return the colour of a track's number; near numbers have hues far from each other."""
    shades = colorsys.hls_to_rgb(number * _GOLDEN % 1.0, 0.68 if is_dark else 0.36, 0.8)
    red, green, blue = (round(255 * shade) for shade in shades)
    return red, green, blue


class SwarmTracks:
    """The targets with their trails, and the tracks of the selected node, or of the first node."""

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._scene, self._stage = scene, stage
        self._targets = add_lines(scene, "/plant/targets", 5.0)
        self._target_trails = add_lines(scene, "/plant/target_trails", 3.0)
        self._marks = add_lines(scene, "/plant/tracks", 2.6)
        self._trails = add_lines(scene, "/plant/track_trails", 1.8)
        self._labels: list[Any] = []

    def node_places(self, frame: StepFrame, past: Sequence[StepFrame]) -> np.ndarray:
        return self._stage.in_scene(frame.stage.positions(frame.step), 0.15)

    def extent(self) -> np.ndarray:
        return self._stage.in_scene(self._stage.whereabouts, 0.15)

    def target(self, frame: StepFrame) -> np.ndarray | None:
        return None

    def shown(self, view: View, frame: StepFrame) -> np.ndarray:
        places = frame.extra.paths[:, PLACES]
        return self._stage.in_scene(places[np.isfinite(places).all(axis=-1)], 0.1)

    def draw(self, view: View, frame: StepFrame, past: Sequence[StepFrame]) -> Callable[[], None]:
        stage, theme = self._stage, view.theme
        tracks = frame.extra.of(view.selected)
        rings = geometry.outlines(
            self.shown(view, frame)[:, :2], np.array([0.1, 0.1]), np.zeros(())
        )
        targets = np.concatenate([rings, np.full((*rings.shape[:-1], 1), 0.1)], axis=-1)
        target_trails = self._target_ways(view, past)
        trails = self._track_ways(view, past, tracks)
        marks = self._crosses(view, tracks)
        names = [] if tracks is None else [f"T{number}" for number in tracks.numbers]
        at = np.zeros((0, 3))
        if tracks is not None:
            at = stage.in_scene(tracks.report.mean[:, PLACES], 0.3)

        def assign() -> None:
            paint(self._targets, targets.reshape(-1, 2, 3), np.array(theme.truth))
            paint(self._target_trails, *target_trails)
            paint(self._trails, *trails)
            paint(self._marks, *marks)
            self._name(names, at)

        return assign

    def _target_ways(self, view: View, past: Sequence[StepFrame]) -> tuple[np.ndarray, np.ndarray]:
        """Return the trails of the targets that are there, as segments and colours."""
        told = [frame.extra.paths[:, PLACES] for frame in past]
        if not told:
            return _NOTHING, _NOTHING
        ways = self._stage.in_scene(np.stack(told), 0.06)
        is_there = np.isfinite(ways[-1]).all(axis=-1)
        return _joined(
            [fading(way, view.theme.truth, view.theme) for way in ways.swapaxes(0, 1)[is_there]]
        )

    def _track_ways(
        self, view: View, past: Sequence[StepFrame], tracks: NodeTracks | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the trails of the tracks that a node has now, as segments and colours."""
        ways: defaultdict[int, list[np.ndarray]] = defaultdict(list)
        for frame in past:
            told = frame.extra.of(view.selected)
            if told is not None:
                for number, mean in zip(told.numbers, told.report.mean, strict=True):
                    ways[number].append(mean[PLACES])
        dark = view.theme.dark
        return _joined(
            [
                fading(
                    self._stage.in_scene(np.array(ways[number]), 0.1),
                    track_colour(number, dark), view.theme,
                )
                for number in (() if tracks is None else tracks.numbers)
            ]
        )  # fmt: skip

    def _crosses(self, view: View, tracks: NodeTracks | None) -> tuple[np.ndarray, np.ndarray]:
        """Return a cross and an ellipse of three deviations for each track, and their colours."""
        if tracks is None or not len(tracks.numbers):
            return _NOTHING, _NOTHING
        stage, report = self._stage, tracks.report
        at = stage.in_scene(report.mean[:, PLACES], 0.12)
        arms = np.array(
            [[[-_ARM, -_ARM, 0], [_ARM, _ARM, 0]], [[-_ARM, _ARM, 0], [_ARM, -_ARM, 0]]]
        )
        crosses = at[:, None, None] + arms
        half = stage.deviations * stage.scale * report.std[:, PLACES]
        rims = geometry.outlines(at[:, :2], half, np.zeros(len(at)), _RIM)
        rims = np.concatenate([rims, np.full((*rims.shape[:-1], 1), 0.12)], axis=-1)
        colours = np.array([track_colour(number, view.theme.dark) for number in tracks.numbers])
        segments = np.concatenate([crosses, rims], axis=1)
        painted = np.repeat(colours, segments.shape[1], axis=0)[:, None]
        return segments.reshape(-1, 2, 3), painted

    def _name(self, names: Sequence[str], at: np.ndarray) -> None:
        """Write the numbers of the tracks beside them; labels that are too many are hidden."""
        for number in range(len(self._labels), len(names)):
            self._labels.append(
                self._scene.add_label(
                    f"/plant/track_names/{number}", "", anchor="bottom-left", font_screen_scale=0.8,
                )
            )  # fmt: skip
        for place, label in enumerate(self._labels):
            label.visible = place < len(names)
            if label.visible:
                label.text, label.position = names[place], tuple(at[place])


def _joined(ways: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the segments and colours of several trails as one."""
    if not ways:
        return _NOTHING, _NOTHING
    segments, colours = zip(*ways, strict=True)
    return np.concatenate(segments), np.concatenate(colours)
