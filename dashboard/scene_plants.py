"""What the network looks at, in the scene: a target in the plane, a car on its track, or errors."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import viser

from dashboard import geometry
from dashboard.frame import Array, Frame
from dashboard.stage import SCENE_WIDTH, Stage
from dashboard.theme import Theme, linear, mixed
from dashboard.view import View

TRAIL = 150
_HIDDEN = 1e-4
_NOTHING = np.zeros((1, 2, 3), dtype=np.float32)


class PlantPicture(Protocol):
    """How a plant is drawn."""

    def node_places(self, frame: Frame, past: Sequence[Frame]) -> Array:
        """Where the nodes are in the scene (N, 3)."""
        ...

    def draw(self, view: View, frame: Frame, past: Sequence[Frame]) -> Callable[[], None]:
        """Work out the picture; returns what assigns it. `past` ends with `frame`."""
        ...


def _lines(scene: viser.SceneApi, name: str, thickness: float) -> Any:
    return scene.add_line_segments(
        name, _NOTHING, np.zeros((1, 2, 3), np.uint8), thickness=thickness,
        thickness_units="screen", visible=False,
    )  # fmt: skip


def _set(handle: Any, segments: Array, colours: np.ndarray) -> None:
    handle.visible = len(segments) > 0
    if len(segments):
        handle.points = segments.astype(np.float32)
        handle.colors = linear(np.broadcast_to(colours, (*segments.shape[:2], 3)))


def _fading(points: Array, colour: tuple[int, int, int], theme: Theme) -> tuple[Array, np.ndarray]:
    """A trail through points (P, 3): segments, and colours that come out of the background."""
    points = points[np.isfinite(points).all(-1)]
    if len(points) < 2:
        return np.zeros((0, 2, 3)), np.zeros((0, 2, 3))
    ground = (16, 16, 16) if theme.dark else (255, 255, 255)
    share = np.linspace(0.12, 1.0, len(points))[:, None]
    shades = share * np.array(colour) + (1 - share) * np.array(ground)
    return geometry.path(points), geometry.path(shades)


class Plane:
    """A target among the nodes: truth, estimates, ellipses, trails, who sees it."""

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
            batched_scales=np.full((n + 1, 3), _HIDDEN),
            batched_opacities=np.full(n + 1, 0.25, np.float32), **hidden,
        )  # fmt: skip
        self._means = scene.add_batched_meshes_simple(
            "/plant/estimates", ball[0].astype(np.float32), ball[1],
            batched_scales=np.full(n + 1, _HIDDEN), **hidden,
        )  # fmt: skip
        self._outlines = _lines(scene, "/plant/outlines", 1.8)
        self._truth = scene.add_icosphere("/plant/truth", radius=1.0, visible=False)
        self._truth_trail = _lines(scene, "/plant/truth_trail", 3.0)
        self._fused_trail = _lines(scene, "/plant/fused_trail", 2.2)
        self._sights = _lines(scene, "/plant/sight", 1.4)
        self._range = _lines(scene, "/plant/range", 1.4)

    def node_places(self, frame: Frame, past: Sequence[Frame]) -> Array:
        return self._stage.in_scene(self._stage.positions(frame.step), 0.15)

    def draw(self, view: View, frame: Frame, past: Sequence[Frame]) -> Callable[[], None]:
        stage, theme = self._stage, view.theme
        states = list(stage.place)
        truth = frame.truth[states]
        known = bool(np.isfinite(truth).all())
        anchor = truth if known else frame.fused.mean[states]
        mean, cov, shown = self._beliefs(view, frame, states)
        magnified = anchor + view.magnify * (mean - anchor)
        at = np.where(shown[:, None], stage.in_scene(np.nan_to_num(magnified), 0.12), 0.0)
        half, angle = geometry.ellipse_axes(np.where(shown[:, None, None], cov, np.eye(2)))
        half = view.magnify * stage.deviations * stage.scale * half
        colours = np.tile(np.array(theme.estimate), (len(mean), 1))
        colours[-1] = theme.fused
        if view.selected is not None:
            colours[view.selected] = theme.selection
        drawn = shown & self._drawn(view)
        scales = np.full((len(mean), 3), _HIDDEN)
        scales[drawn, :2] = half[drawn]
        # Filled: the fused one and the selected; of the others the outline is enough.
        filled = drawn & (np.arange(len(mean)) >= stage.nodes)
        if view.selected is not None:
            filled[view.selected] = drawn[view.selected]
        scales[drawn & ~filled] = _HIDDEN
        rims = geometry.outlines(at[drawn, :2], half[drawn], angle[drawn])
        flat = rims.reshape(-1, 2, 2)
        outlines = np.concatenate([flat, np.full((len(flat), 2, 1), 0.125)], axis=-1)
        quiet = np.where(filled[:, None], colours, mixed(theme.estimate, theme.panel, 0.7))
        rim_colours = np.repeat(quiet[drawn], rims.shape[1], axis=0)[:, None]
        dots = np.where(shown, 0.075 if len(mean) < 60 else 0.05, _HIDDEN)
        trail = stage.in_scene(np.array([f.truth[states] for f in past]), 0.06)
        fused_trail = stage.in_scene(np.array([f.fused.mean[states] for f in past]), 0.05)
        sights = self._sight_lines(view, frame, truth)
        circle = self._range_circle(view, frame)

        def assign() -> None:
            self._fill.batched_positions = at.astype(np.float32)
            self._fill.batched_wxyzs = geometry.about_vertical(angle).astype(np.float32)
            self._fill.batched_scales = scales.astype(np.float32)
            self._fill.batched_colors = linear(colours)
            self._means.batched_positions = (at + np.array([0, 0, 0.05])).astype(np.float32)
            self._means.batched_scales = dots.astype(np.float32)
            self._means.batched_colors = linear(colours)
            _set(self._outlines, outlines, rim_colours)
            _set(self._truth_trail, *_fading(trail, theme.truth, theme))
            _set(self._fused_trail, *_fading(fused_trail, theme.fused, theme))
            _set(self._sights, sights, np.array(mixed(theme.seeing, theme.panel, 0.75)))
            _set(self._range, circle, np.array(theme.quiet))
            self._truth.visible = known
            if known:
                self._truth.position = tuple(stage.in_scene(truth, 0.25))
                self._truth.scale = 0.2
                self._truth.color = theme.truth

        return assign

    def _beliefs(
        self, view: View, frame: Frame, states: list[int]
    ) -> tuple[Array, Array, np.ndarray]:
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

    def _sight_lines(self, view: View, frame: Frame, truth: Array) -> Array:
        if not view.sight_lines or not np.isfinite(truth).all() or not frame.seen.any():
            return np.zeros((0, 2, 3))
        eyes = self.node_places(frame, ())[frame.seen]
        target = np.broadcast_to(self._stage.in_scene(truth, 0.25), eyes.shape)
        return np.stack([eyes, target], axis=1)

    def _range_circle(self, view: View, frame: Frame) -> Array:
        reach_m = self._stage.sight_range_m
        if not view.sight_range or reach_m is None or view.selected is None:
            return np.zeros((0, 2, 3))
        centre = self.node_places(frame, ())[view.selected]
        half = np.full(2, reach_m * self._stage.scale)
        rim = geometry.outlines(centre[:2], half, np.zeros(()), 96)
        segments = np.concatenate([rim, np.full((*rim.shape[:2], 1), 0.03)], axis=-1)
        return segments[::2]


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
            "batched_scales": np.full((n, 3), _HIDDEN),
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

    def node_places(self, frame: Frame, past: Sequence[Frame]) -> Array:
        return self._stage.in_scene(self._stage.positions(frame.step), 0.15)

    def draw(self, view: View, frame: Frame, past: Sequence[Frame]) -> Callable[[], None]:
        stage, theme = self._stage, view.theme
        error, width = frame.scores.error, stage.deviations * frame.scores.width
        top = float(np.nanmax(width)) if np.isfinite(width).any() else 1.0
        units = self._HEIGHT / top if top > 0 else 1.0
        places = self.node_places(frame, past)
        known = np.isfinite(error) & np.isfinite(width)
        height = np.clip(np.nan_to_num(error) * units, _HIDDEN, 2.5 * self._HEIGHT)
        scales = np.full((stage.nodes, 3), _HIDDEN)
        scales[known] = np.stack(
            [np.full(stage.nodes, self._width), np.full(stage.nodes, self._width), height], axis=-1
        )[known]
        over = error > width
        colours = np.where(over[:, None], theme.down, theme.estimate)
        plates = places + np.stack([0 * width, 0 * width, np.nan_to_num(width) * units], axis=-1)
        plate_scales = np.where(known, 1.3 * self._width, _HIDDEN)

        def assign() -> None:
            self._posts.batched_positions = places.astype(np.float32)
            self._posts.batched_scales = scales.astype(np.float32)
            self._posts.batched_colors = linear(colours)
            self._plates.batched_positions = plates.astype(np.float32)
            self._plates.batched_scales = np.repeat(plate_scales[:, None], 3, 1).astype(np.float32)
            self._plates.batched_colors = linear(np.tile(theme.fused, (stage.nodes, 1)))

        return assign


class CarTrack:
    """A car on its track: the way it went, the way each node believes, the network above the car.

    The way is dead reckoning from speed, heading and side slip; for a node, from its estimates.
    """

    _ABOVE, _SPREAD = 1.6, 0.13

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._stage = stage
        names = stage.state_names
        self._states = [names.index(name) for name in ("speed", "heading", "side slip")]
        self._truth_way = _lines(scene, "/plant/truth_trail", 4.0)
        self._node_ways = _lines(scene, "/plant/node_trails", 1.6)
        self._stems = _lines(scene, "/plant/stems", 1.0)
        self._car = scene.add_box("/plant/car", dimensions=(0.95, 0.42, 0.22), visible=False)
        self._cabin = scene.add_box("/plant/cabin", dimensions=(0.45, 0.36, 0.18), visible=False)
        self._reach_m = 1.0

    def _ways(self, past: Sequence[Frame]) -> tuple[Array, Array]:
        """Ways (T, 2) of the car and (T, N, 2) of the nodes' estimates, in metres."""
        truth = np.array([frame.truth[self._states] for frame in past])
        nodes = np.array([frame.belief.mean[:, self._states] for frame in past])
        step_s = self._stage.setup.time_step_s
        return _reckoned(truth, step_s), _reckoned(nodes, step_s)

    def _drawn(self, way: Array, height: float) -> Array:
        flat = way * (0.6 * SCENE_WIDTH / self._reach_m)
        flat = flat - [0.36 * SCENE_WIDTH, 0.0]
        return np.concatenate([flat, np.full((*flat.shape[:-1], 1), height)], axis=-1)

    def node_places(self, frame: Frame, past: Sequence[Frame]) -> Array:
        way, _ = self._ways(past)
        reach = np.abs(way[np.isfinite(way).all(-1)])
        if len(reach):
            # Grows with the drive, in steps, so that the picture rests in between.
            longest = float(reach.max()) / 1.5
            steps = np.ceil(np.log(max(longest, 10.0) / 10.0) / np.log(1.5))
            self._reach_m = max(self._reach_m, 10.0 * 1.5 ** (steps + 1))
        car = self._drawn(np.nan_to_num(way[-1]), 0.0)
        around = self._stage.in_scene(self._stage.positions(0), self._ABOVE)
        return car + around * [self._SPREAD, self._SPREAD, 1.0]

    def draw(self, view: View, frame: Frame, past: Sequence[Frame]) -> Callable[[], None]:
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
            _set(self._truth_way, truth[np.isfinite(truth).all((-1, -2))], np.array(theme.truth))
            _set(self._node_ways, segments[finite], painted[finite][:, None])
            _set(self._stems, stems, np.array(theme.grid_section))
            for body, up in ((self._car, 0.0), (self._cabin, 0.18)):
                body.visible = known
                if known:
                    body.position = tuple(car + np.array([0.0, 0.0, up]))
                    body.wxyz = tuple(geometry.about_vertical(np.array(heading)))
                    body.color = theme.truth if up == 0.0 else theme.quiet

        return assign


def _reckoned(moving: Array, step_s: float) -> Array:
    """Places (T, ..., 2) of (speed, heading, side slip) (T, ..., 3), from the origin."""
    speed, course = moving[..., 0], moving[..., 1] + moving[..., 2]
    velocity = speed[..., None] * np.stack([np.cos(course), np.sin(course)], axis=-1)
    ways = np.cumsum(np.nan_to_num(velocity) * step_s, axis=0)
    return np.concatenate([np.zeros_like(ways[:1]), ways[:-1]], axis=0)
