"""Target among the nodes: its position, each node's estimate, and the nodes that see it."""

from collections.abc import Callable, Sequence

import numpy as np
import viser

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import SCENE_WIDTH, Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import HIDDEN, add_lines, fading, paint
from concord.dashboard.theme import linear, mixed
from concord.dashboard.view import View

# Of the half-width of the map: where the marks are.
_EDGE = 1.12
_LENGTH, _HEAD = 1.3, 0.55


def edge_of(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and the upper corner (2,) of the edge around places (P, 2 or more)."""
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1.0)
    return middle - _EDGE * half, middle + _EDGE * half


def is_outside(points: np.ndarray, edge: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return which of points (P, 2 or more) lie outside; a point that is not finite does not."""
    low, high = edge
    return np.asarray(((points[:, :2] < low) | (points[:, :2] > high)).any(axis=1))


def arrows(points: np.ndarray, edge: tuple[np.ndarray, np.ndarray], height: float) -> np.ndarray:
    """Return segments (3 P, 2, 3) of arrows at the edge, from its middle towards points (P, 2)."""
    low, high = edge
    middle, half = (low + high) / 2, (high - low) / 2
    off = points[:, :2] - middle
    share = np.abs(off / half).max(axis=1, keepdims=True)
    tip = middle + off / share
    way = off / np.linalg.norm(off, axis=1, keepdims=True)
    across = np.stack([-way[:, 1], way[:, 0]], axis=1)
    tail = tip - _LENGTH * way
    wings = [tip - _HEAD * way + side * 0.6 * _HEAD * across for side in (-1.0, 1.0)]
    segments = np.stack(
        [np.stack([tail, tip], axis=1), *(np.stack([wing, tip], axis=1) for wing in wings)], axis=1
    ).reshape(-1, 2, 2)
    return np.concatenate([segments, np.full((*segments.shape[:2], 1), height)], axis=-1)


_MOST_FILLED = 0.25
"""Part of the map that a filled ellipse may cover."""


class Plane:
    """Target among the nodes: truth, estimates, ellipses, trails, and the nodes that see it."""

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._stage = stage
        n = stage.nodes
        disc = geometry.disc()
        ball = geometry.sphere()
        turned = np.tile([1.0, 0.0, 0.0, 0.0], (n + 1, 1))
        hidden = {
            "batched_wxyzs": turned,
            "batched_positions": np.zeros((n + 1, 3)),
            "batched_colors": np.full((n + 1, 3), 128, np.uint8),
            "lod": "off",
        }
        self._fill = scene.add_batched_meshes_simple(
            "/plant/sets", disc[0].astype(np.float32), disc[1], side="double",
            batched_scales=np.full((n + 1, 3), HIDDEN),
            batched_opacities=np.full(n + 1, 0.25, np.float32), **hidden,
        )  # fmt: skip
        self._means = scene.add_batched_meshes_simple(
            "/plant/estimates", ball[0].astype(np.float32), ball[1],
            batched_scales=np.full(n + 1, HIDDEN), **hidden,
        )  # fmt: skip
        self._outlines = add_lines(scene, "/plant/outlines", 1.8)
        self._truth = scene.add_icosphere("/plant/truth", radius=1.0, visible=False)
        self._truth_trail = add_lines(scene, "/plant/truth_trail", 3.0)
        self._fused_trail = add_lines(scene, "/plant/fused_trail", 2.2)
        self._sights = add_lines(scene, "/plant/sight", 1.4)
        self._range = add_lines(scene, "/plant/range", 1.4)
        self._outside = add_lines(scene, "/plant/outside", 3.0)
        self._edge = edge_of(self.extent())
        # Panels may hide a corner of the map.
        places = self.extent()[:, :2]
        below = (float(places[:, 0].mean()), float(places[:, 1].min()), 0.1)
        self._factor = scene.add_label(
            "/plant/factor", "", position=below, anchor="top-center", font_screen_scale=0.85
        )

    def node_places(self, frame: StepFrame, past: Sequence[StepFrame]) -> np.ndarray:
        return self._stage.in_scene(frame.stage.positions(frame.step), 0.15)

    def extent(self) -> np.ndarray:
        return self._stage.in_scene(self._stage.whereabouts, 0.15)

    def target(self, frame: StepFrame) -> np.ndarray | None:
        truth = frame.truth[list(self._stage.place)]
        return self._stage.in_scene(truth, 0.25) if np.isfinite(truth).all() else None

    def shown(self, view: View, frame: StepFrame) -> np.ndarray:
        at, _, _, shown = self._magnified(view, frame)
        target = self.target(frame)
        points = at[shown]
        return points if target is None else np.concatenate([points, target[None]])

    def _magnified(
        self, view: View, frame: StepFrame
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return where beliefs are drawn (N + 1, 3), half-axes, angles, and which are finite."""
        stage, states = self._stage, list(self._stage.place)
        truth = frame.truth[states]
        anchor = truth if np.isfinite(truth).all() else frame.fused.mean[states]
        mean, cov, shown = self._beliefs(frame, states)
        magnified = anchor + view.magnify * (mean - anchor)
        at = np.where(shown[:, None], stage.in_scene(np.nan_to_num(magnified), 0.12), 0.0)
        # One disc over the other: at one height they would flicker through each other.
        at[-1, 2] -= 0.04
        half, angle = geometry.ellipse_axes(np.where(shown[:, None, None], cov, np.eye(2)))
        return at, view.magnify * frame.stage.deviations * stage.scale * half, angle, shown

    def draw(self, view: View, frame: StepFrame, past: Sequence[StepFrame]) -> Callable[[], None]:
        stage, theme = self._stage, view.theme
        states = list(stage.place)
        truth = frame.truth[states]
        known = bool(np.isfinite(truth).all())
        at, half, angle, shown = self._magnified(view, frame)
        colours = np.tile(np.array(theme.estimate), (len(at), 1))
        colours[-1] = theme.fused
        if view.selected is not None:
            colours[view.selected] = theme.selection
        drawn = shown & self._drawn(view)
        scales = np.full((len(at), 3), HIDDEN)
        scales[drawn, :2] = half[drawn]
        # Filled: the fused one and the selected; of the others the outline is enough.
        filled = drawn & (np.arange(len(at)) >= stage.nodes)
        if view.selected is not None:
            filled[view.selected] = drawn[view.selected]
        # A filled ellipse that covers the map hides all that is below.
        filled &= np.pi * half.prod(axis=-1) <= _MOST_FILLED * SCENE_WIDTH**2
        filled &= half.max(axis=-1) <= SCENE_WIDTH / 2
        scales[drawn & ~filled] = HIDDEN
        rims = geometry.outlines(at[drawn, :2], half[drawn], angle[drawn])
        flat = rims.reshape(-1, 2, 2)
        outlines = np.concatenate([flat, np.full((len(flat), 2, 1), 0.125)], axis=-1)
        quiet = np.where(filled[:, None], colours, mixed(theme.estimate, theme.panel, 0.7))
        rim_colours = np.repeat(quiet[drawn], rims.shape[1], axis=0)[:, None]
        dots = np.where(shown, 0.075 if len(at) < 60 else 0.05, HIDDEN)
        trail = stage.in_scene(np.array([f.truth[states] for f in past]), 0.06)
        fused_trail = stage.in_scene(np.array([f.fused.mean[states] for f in past]), 0.05)
        sights = self._sight_lines(view, frame, truth)
        circle = self._range_circle(view, frame)
        outside, outside_colours = self._marks_at_edge(view, frame, at, shown)

        def assign() -> None:
            self._fill.batched_positions = at.astype(np.float32)
            self._fill.batched_wxyzs = geometry.about_vertical(angle).astype(np.float32)
            self._fill.batched_scales = scales.astype(np.float32)
            self._fill.batched_colors = linear(colours)
            self._means.batched_positions = (at + np.array([0, 0, 0.05])).astype(np.float32)
            self._means.batched_scales = dots.astype(np.float32)
            self._means.batched_colors = linear(colours)
            paint(self._outlines, outlines, rim_colours)
            paint(self._truth_trail, *fading(trail, theme.truth, theme))
            paint(self._fused_trail, *fading(fused_trail, theme.fused, theme))
            paint(self._sights, sights, np.array(mixed(theme.seeing, theme.panel, 0.75)))
            paint(self._range, circle, np.array(theme.quiet))
            paint(self._outside, outside, outside_colours)
            self._factor.text = f"errors × {view.magnify:g}"
            self._truth.visible = known
            if known:
                self._truth.position = tuple(stage.in_scene(truth, 0.25))
                self._truth.scale = 0.2
                self._truth.color = theme.truth

        return assign

    def _marks_at_edge(
        self, view: View, frame: StepFrame, at: np.ndarray, shown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return arrows (A, 2, 3) at the edge towards the beliefs and the truth outside, and their
        colours (A, 1, 3)."""
        theme, target = view.theme, self.target(frame)
        colours = np.tile(np.array(theme.estimate), (len(at), 1))
        colours[-1] = theme.fused
        points, painted = at[shown], colours[shown]
        if target is not None:
            points = np.concatenate([points, target[None]])
            painted = np.concatenate([painted, np.array([theme.truth])])
        out = is_outside(points, self._edge)
        segments = arrows(points[out], self._edge, 0.14)
        return segments, np.repeat(painted[out], 3, axis=0)[:, None]

    def _beliefs(
        self, frame: StepFrame, states: list[int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means (N + 1, 2), covariances and which are finite: the nodes', then the fused one."""
        mean = np.concatenate([frame.belief.mean, frame.fused.mean[None]])[:, states]
        cov = np.concatenate([frame.belief.cov, frame.fused.cov[None]])[:, states][:, :, states]
        finite = np.isfinite(mean).all(axis=-1) & np.isfinite(cov).all(axis=(-1, -2))
        return mean, cov, np.asarray(finite)

    def _drawn(self, view: View) -> np.ndarray:
        chosen = np.full(self._stage.nodes + 1, view.ellipses == "all")
        if view.ellipses != "none":
            chosen[-1] = True
            if view.selected is not None:
                chosen[view.selected] = True
        return chosen

    def _sight_lines(self, view: View, frame: StepFrame, truth: np.ndarray) -> np.ndarray:
        if not view.sight_lines or not np.isfinite(truth).all() or not frame.seen.any():
            return np.zeros((0, 2, 3))
        eyes = self.node_places(frame, ())[frame.seen]
        target = np.broadcast_to(self._stage.in_scene(truth, 0.25), eyes.shape)
        return np.stack([eyes, target], axis=1)

    def _range_circle(self, view: View, frame: StepFrame) -> np.ndarray:
        reach_m = self._stage.sight_range_m
        if not view.sight_range or reach_m is None or view.selected is None:
            return np.zeros((0, 2, 3))
        centre = self.node_places(frame, ())[view.selected]
        half = np.full(2, reach_m * self._stage.scale)
        rim = geometry.outlines(centre[:2], half, np.zeros(()), 96)
        segments = np.concatenate([rim, np.full((*rim.shape[:2], 1), 0.1)], axis=-1)
        return segments[::2]
