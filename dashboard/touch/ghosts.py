"""Ghosts in the scene: changes that wait for the next step, and a link while a hand draws it."""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
import viser

from concord.dashboard.scene import geometry
from concord.dashboard.scene.plants import add_lines, paint
from concord.dashboard.theme import Theme

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
        edges: np.ndarray,
        waiting: Sequence[Mapping[str, Any]],
    ) -> None:
        """Show the commands that wait, where the nodes are at (N, 3) and have links (E, 2)."""
        shown = (theme.dark, at.round(2).tobytes(), str(waiting))
        if shown == self._shown:
            return
        self._shown = shown
        for label in self._labels:
            label.remove()
        segments, self._labels = [], []
        there = {*map(tuple, edges.tolist())}
        told = [(command, nodes) for command in waiting for nodes in places_of(command, there)]
        for number, (command, nodes) in enumerate(told):
            segments.append(_outline(at, radius, nodes))
            place = at[list(nodes[:2])].mean(axis=0)
            place[2] += 1.5 * radius
            words = str(command.get("kind", command["do"]))
            self._labels.append(
                self._scene.add_label(
                    f"/pending/word{number}", f"next step: {words}", position=tuple(place),
                    anchor="bottom-left", font_screen_scale=0.85,
                )
            )  # fmt: skip
        drawn = np.concatenate(segments) if segments else np.zeros((0, 2, 3))
        paint(self._lines, drawn, np.array(theme.selection))

    def follow(self, theme: Theme, start: np.ndarray, end: np.ndarray) -> None:
        """Show the link that a hand draws from one point (3,) to another."""
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


def _outline(at: np.ndarray, radius: float, nodes: tuple[int, ...]) -> np.ndarray:
    """Return dashes (S, 2, 3): a line for a link, and a ring about each node of anything else."""
    if len(nodes) == 2:
        return geometry.dashed(at[np.newaxis, list(nodes)], 9)
    flat = np.stack([np.cos(_RING), np.sin(_RING), np.zeros_like(_RING)], axis=-1)
    return np.concatenate([geometry.path(at[node] + 2.2 * radius * flat)[::2] for node in nodes])
