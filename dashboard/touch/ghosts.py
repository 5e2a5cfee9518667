"""Ghosts in the scene: changes that wait for the next step, and a link while a hand draws it."""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
import viser

from concord.dashboard.frames.stage import Stage
from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import add_lines, paint
from concord.dashboard.theme import Theme
from concord.plants.placement import sites

_RING = np.linspace(0.0, 2 * np.pi, 33)


class PendingGhosts:
    """Dashed lines and words where something is about to change."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._lines = add_lines(scene, "/pending/lines", 3.0)
        self._drawing = add_lines(scene, "/pending/drawing", 3.0)
        self._labels: list[Any] = []
        self._shown: object = None

    def draw(
        self,
        theme: Theme,
        at: np.ndarray,
        radius: float,
        stage: Stage,
        waiting: Sequence[Mapping[str, Any]],
    ) -> None:
        """Show the commands that wait, where the nodes of a stage are at (N, 3)."""
        shown = (theme.dark, at.round(2).tobytes(), str(waiting))
        if shown == self._shown:
            return
        self._shown = shown
        for label in self._labels:
            label.remove()
        segments, self._labels = [], []
        there = {*map(tuple, stage.edges.tolist())}
        told = [(command, nodes) for command in waiting for nodes in places_of(command, there)]
        for command, nodes in told:
            segments.append(_outline(at, radius, nodes))
            self._label(at[list(nodes[:2])].mean(axis=0), radius, command)
        for command in waiting:
            for node, place in moves_of(command, stage):
                ends = np.stack([at[node], stage.in_scene(place, at[node, 2])])
                segments += [geometry.dashed(ends[None], 9), _outline(ends, radius, (1,))]
                self._label(ends[1], radius, command)
        drawn = np.concatenate(segments) if segments else np.zeros((0, 2, 3))
        paint(self._lines, drawn, np.array(theme.selection))

    def _label(self, place: np.ndarray, radius: float, command: Mapping[str, Any]) -> None:
        words = str(command.get("kind", command["do"]))
        label = self._scene.add_label(
            f"/pending/word{len(self._labels)}", f"next step: {words}",
            position=(place[0], place[1], place[2] + 1.5 * radius), anchor="bottom-left",
            font_screen_scale=0.85,
        )  # fmt: skip
        self._labels.append(label)

    def follow(self, theme: Theme, start: np.ndarray, end: np.ndarray) -> None:
        """Show the line that a hand draws from one point (3,) to another."""
        paint(self._drawing, geometry.dashed(np.array([[start, end]])), np.array(theme.selection))

    def let_go(self) -> None:
        """Show no such link."""
        self._drawing.visible = False


def places_of(
    command: Mapping[str, Any], edges: AbstractSet[tuple[int, int]]
) -> list[tuple[int, ...]]:
    """Return the nodes and the ends of links that a command changes in a network of these `edges`;
    none where it changes the whole network."""
    if "node" in command:
        return [(int(command["node"]),)]
    if command.get("sender") is not None:
        return [(int(command["sender"]), int(command["receiver"]))]
    if "graph" in command.get("settings", {}):
        # Only here: networkx and scipy take long to load.
        from concord.topology.edge_text import read_edge_text

        graph = read_edge_text(command["settings"]["graph"].removeprefix("edges:"), None)
        wanted = np.sort(np.stack(graph.nonzero(), axis=1), axis=1).tolist()
        return sorted({*map(tuple, wanted)} ^ edges)
    nodes = tuple(map(int, command.get("nodes", ())))
    return [nodes] if nodes else []


def moves_of(command: Mapping[str, Any], stage: Stage) -> list[tuple[int, np.ndarray]]:
    """Return the nodes of a stage that a command moves, each with its new place (2,) in m."""
    placement = command.get("settings", {}).get("placement")
    if placement is None:
        return []
    after, before = sites(placement, stage.nodes), stage.positions(0)
    return [(int(node), after[node]) for node in np.flatnonzero((after != before).any(axis=1))]


def _outline(at: np.ndarray, radius: float, nodes: tuple[int, ...]) -> np.ndarray:
    """Return dashes (S, 2, 3): a line for a link, and a ring about each node of anything else."""
    if len(nodes) == 2:
        return geometry.dashed(at[np.newaxis, list(nodes)], 9)
    flat = np.stack([np.cos(_RING), np.sin(_RING), np.zeros_like(_RING)], axis=-1)
    return np.concatenate([geometry.path(at[node] + 2.2 * radius * flat)[::2] for node in nodes])
