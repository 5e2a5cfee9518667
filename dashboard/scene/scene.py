"""The 3-D scene: handles made once, properties assigned with every frame."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from concord.dashboard.frames.conditions import DOWN, REJECTED, STALE, conditions
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import SCENE_WIDTH, PlantDrawing, Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plane import Plane
from concord.dashboard.scene.plants import HIDDEN, PlantPicture, add_lines, paint
from concord.dashboard.scene.posts import ErrorPosts
from concord.dashboard.scene.signs import colour_of
from concord.dashboard.scene.track import CarTrack
from concord.dashboard.theme import Theme, linear, mixed
from concord.dashboard.view import MOST_LABELS, View

_NODE_HEIGHT = 0.02
# Above these they hide everything, and say nothing.
_MOST_LINKS = 2000
PLANTS: dict[PlantDrawing, Callable[..., PlantPicture]] = {
    PlantDrawing.PLANE: Plane,
    PlantDrawing.TRACK: CarTrack,
    PlantDrawing.GRAPH: ErrorPosts,
}


class Scene:
    """The network and its plant in one viewport.

    `pick(node)` is called with the node that the user clicked.
    """

    def __init__(
        self, scene: viser.SceneApi, stage: Stage, theme: Theme, pick: Callable[[int], None] | None
    ) -> None:
        self._scene, self._stage = scene, stage
        largest = 0.22 if stage.picture is PlantDrawing.TRACK else 0.4
        self.radius = float(np.clip(0.34 * np.sqrt(20 / stage.nodes), 0.11, largest))
        self._labels: list[Any] = []
        self._surroundings(theme)
        self.nodes = self._one_at_each_node("/network/nodes", geometry.sphere(), self.radius)
        if pick is not None:
            self.nodes.on_click(lambda event: pick(event.instance_index))
        self._halo = self._one_at_each_node(
            "/network/attention", geometry.ring(0.8), HIDDEN, side="double"
        )
        self._edges = add_lines(scene, "/network/links", 1.6 if len(stage.edges) < 600 else 1.0)
        self._cut = add_lines(scene, "/network/cut", 2.2)
        self._sending = add_lines(scene, "/network/sending", 4.5)
        vertices, faces = geometry.ring(0.84)
        self._selected = scene.add_mesh_simple(
            "/network/selected", vertices, faces, side="double", visible=False
        )
        self._hovered = scene.add_mesh_simple(
            "/network/hovered", vertices, faces, side="double", visible=False, opacity=0.6
        )
        draw = PLANTS[stage.picture] if stage.own is None else stage.own.picture
        self.plant: PlantPicture = draw(scene, stage)
        self._shown_labels: tuple[object, ...] | None = None
        self.target: np.ndarray | None = None
        """Where the target is in the scene (3,), once it is drawn; None of an unknown one."""
        self._drawn: tuple[View, StepFrame] | None = None
        self.at: np.ndarray | None = None
        """Where the nodes are in the scene (N, 3), once they are drawn."""

    def _surroundings(self, theme: Theme) -> None:
        scene = self._scene
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(hdri=None)
        scene.add_light_ambient("/light/ambient", intensity=1.7)
        scene.add_light_directional("/light/sun", intensity=1.4, position=(40.0, -60.0, 120.0))
        scene.set_up_direction("+z")
        self.set_theme(theme)

    def set_theme(self, theme: Theme) -> None:
        """Repaint what no frame repaints."""
        self.theme = theme
        cell = cell_m(self._stage) * self._stage.scale if is_to_scale(self._stage) else 2.0
        self._scene.add_grid(
            "/grid",
            width=3 * SCENE_WIDTH,
            height=3 * SCENE_WIDTH,
            cell_size=cell,
            section_size=cell,
            cell_color=theme.grid,
            section_color=theme.grid_section,
            fade_distance=60.0,
            position=(0.0, 0.0, -0.02),
            plane_opacity=0.0,
            shadow_opacity=0.0,
        )
        self._shown_labels = None

    def _one_at_each_node(
        self, name: str, mesh: tuple[np.ndarray, np.ndarray], size: float, **options: Any
    ) -> Any:
        """Add a mesh, vertices (V, 3) and faces (F, 3), at each node."""
        vertices, faces = mesh
        nodes = self._stage.nodes
        return self._scene.add_batched_meshes_simple(
            name,
            vertices.astype(np.float32),
            faces,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (nodes, 1)),
            batched_positions=self._stage.in_scene(self._stage.positions(0), _NODE_HEIGHT),
            batched_scales=np.full(nodes, size),
            batched_colors=np.full((nodes, 3), 128, dtype=np.uint8),
            lod="off",
            **options,
        )

    def extent(self) -> np.ndarray:
        """Points of the scene (P, 3) between which all of it lies, nodes and their names too."""
        points, air = self.plant.extent(), 2.0 * self.radius
        around = np.array([(x, y, 0.0) for x in (-air, air) for y in (-air, air)])
        return (points[:, None] + around).reshape(-1, 3)

    @property
    def shown(self) -> np.ndarray:
        """Return the points (P, 3) at which the newest picture has beliefs and the truth."""
        return np.zeros((0, 3)) if self._drawn is None else self.plant.shown(*self._drawn)

    @property
    def frame(self) -> StepFrame | None:
        """Return the frame of the newest picture."""
        return None if self._drawn is None else self._drawn[1]

    def draw(
        self, view: View, frame: StepFrame, past: Sequence[StepFrame], sender: int
    ) -> Callable[[], None]:
        """Work out the picture; returns what assigns it, for inside of one `atomic()`."""
        stage, theme = self._stage, view.theme
        words = conditions(frame)
        at = self.plant.node_places(frame, past)
        colours = np.array([colour_of(theme, word) for word in words])
        scales = np.full(stage.nodes, self.radius)
        scales[[word == DOWN for word in words]] *= 0.75
        if sender >= 0:
            colours[sender] = theme.sending
            scales[sender] *= 1.35
        alarmed = np.array([word in (DOWN, REJECTED, STALE) for word in words])
        halo = np.where(alarmed, 1.55 * self.radius, HIDDEN)
        links, link_colours, cut = self._links(view, frame, at)
        sending = self._sending_links(frame, at, sender)
        plant = self.plant.draw(view, frame, past)
        self.target, self._drawn, self.at = self.plant.target(frame), (view, frame), at
        self._label(view, frame, at)

        def assign() -> None:
            self.nodes.batched_positions = at.astype(np.float32)
            self.nodes.batched_colors = linear(colours)
            self.nodes.batched_scales = scales.astype(np.float32)
            self._halo.batched_positions = (at - [0, 0, 0.5 * self.radius]).astype(np.float32)
            self._halo.batched_scales = halo.astype(np.float32)
            self._halo.batched_colors = linear([colour_of(theme, word) for word in words])
            paint(self._edges, links, link_colours)
            paint(self._cut, cut, np.broadcast_to(theme.down, (*cut.shape[:2], 3)))
            paint(self._sending, sending, np.broadcast_to(theme.sending, (*sending.shape[:2], 3)))
            self._mark(self._selected, view.selected, at, theme.selection, 1.75)
            self._mark(self._hovered, view.hovered, at, theme.quiet, 2.0)
            plant()

        return assign

    def _mark(self, ring: Any, node: int | None, at: np.ndarray, colour: Any, size: float) -> None:
        ring.visible = node is not None
        if node is not None:
            ring.position = tuple(at[node])
            ring.scale = size * self.radius
            ring.color = colour

    def _links(
        self, view: View, frame: StepFrame, at: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Segments and colours of the links that are up, and the dashes of those that are cut."""
        edges, theme = frame.stage.edges, view.theme
        if not len(edges):
            return _NO_LINES, np.zeros((0, 2, 3), np.uint8), _NO_LINES
        ends = at[edges]
        dead = ~frame.alive[edges].all(1)
        # The more links there are, the quieter is each.
        share = float(np.clip(np.sqrt(150 / len(edges)), 0.12, 1.0))
        ground = (16, 16, 16) if theme.dark else (255, 255, 255)
        colours = np.tile(np.array(mixed(theme.edge, ground, share)), (len(edges), 1))
        if view.selected is not None and share < 1:
            colours[(edges == view.selected).any(1)] = theme.edge
        colours[dead] = mixed(theme.down, theme.panel, 0.45)
        up = ~frame.cut
        if len(edges) > _MOST_LINKS:
            up &= dead | (edges == (-1 if view.selected is None else view.selected)).any(1)
        painted = np.repeat(colours[up][:, None], 2, axis=1)
        return ends[up], painted, geometry.dashed(ends[frame.cut])

    def _sending_links(self, frame: StepFrame, at: np.ndarray, sender: int) -> np.ndarray:
        edges = frame.stage.edges
        if sender < 0 or not len(edges):
            return _NO_LINES
        hers = (edges == sender).any(1) & ~frame.cut & frame.alive[edges].all(1)
        return at[edges[hers]] + [0, 0, 0.08]

    def _label(self, view: View, frame: StepFrame, at: np.ndarray) -> None:
        """Names beside the nodes, where they have room; again only when something about them is."""
        wanted = view.labels and self._stage.nodes <= MOST_LABELS
        places = tuple(map(tuple, np.round(at, 1))) if wanted else ()
        shown = (wanted, view.theme.dark, places)
        if shown == self._shown_labels:
            return
        self._shown_labels = shown
        # Above a node of a graph stands its post.
        below = self._stage.picture is PlantDrawing.GRAPH
        anchor, off = ("top-center", (0, -1.2, 0)) if below else ("bottom-center", (0, 0, 1.5))
        if wanted and not self._labels:
            self._labels = [
                self._scene.add_label(
                    f"/labels/{node}", name, position=tuple(at[node]), anchor=anchor,
                    font_screen_scale=0.75, font_size_mode="screen",
                )
                for node, name in enumerate(self._stage.names)
            ]  # fmt: skip
        for node, label in enumerate(self._labels):
            label.visible = wanted
            label.position = tuple(at[node] + self.radius * np.array(off))


_NO_LINES = np.zeros((0, 2, 3))


def cell_m(stage: Stage) -> float:
    """Return the width of a cell of the grid: a round number of metres."""
    metres = 2.0 / stage.scale
    power = 10.0 ** np.floor(np.log10(metres))
    return float(min((1, 2, 5, 10), key=lambda step: abs(step * power - metres)) * power)


def is_to_scale(stage: Stage) -> bool:
    """Say whether the scene is a map."""
    return stage.picture in (PlantDrawing.PLANE, PlantDrawing.OWN)
