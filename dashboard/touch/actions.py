"""Commands that a menu offers for a node or a link: labels, and the words behind each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from concord.dashboard.frames.frame import StepFrame

_ALIVE = {"kill": "kill {0}", "lie": "lie {0} 5 4", "honest": "lie {0} 0 1", "hang": "hang {0} 5"}
_DOWN = {"restart": "restart {0}"}
_UP = {
    "cut": "cut {0} {1}", "lose 30 %": "loss 0.3 {0} {1}", "lose none": "loss 0 {0} {1}",
    "corrupt 5 %": "corrupt 0.05 {0} {1}",
}  # fmt: skip
_CUT = {"heal": "heal {0} {1}"}


def actions(frame: StepFrame, nodes: tuple[int, ...]) -> dict[str, str]:
    """Return the commands for a node, or for the link between two, by their labels."""
    if len(nodes) == 1:
        offered = _ALIVE if frame.alive[nodes[0]] else _DOWN
    else:
        offered = _CUT if is_cut(frame, nodes) else _UP
    return {label: words.format(*nodes) for label, words in offered.items()}


def is_cut(frame: StepFrame, ends: tuple[int, ...]) -> bool:
    """Return whether the link between two nodes is cut."""
    is_it = (np.sort(frame.stage.edges, axis=1) == sorted(ends)).all(axis=1)
    return bool(frame.cut[is_it].any())


def drawn_link(
    frame: StepFrame, ends: tuple[int, int], waiting: Sequence[Mapping[str, Any]] = ()
) -> str:
    """Return the command for a link that a hand draws: it cuts one that is up, heals one that is
    cut, and gives the network one that it lacks.

    A new link comes beside those of the commands that wait.
    """
    stage = frame.stage
    if ends[1] in stage.setup.neighbours[ends[0]] or ends[0] in stage.setup.neighbours[ends[1]]:
        return f"{'heal' if is_cut(frame, ends) else 'cut'} {ends[0]} {ends[1]}"
    # Only here: networkx and scipy take long to load.
    from concord.topology.edge_text import edge_text, read_edge_text

    hears = np.zeros((stage.nodes, stage.nodes))
    hears[tuple(stage.heard.T)] = 1
    for command in waiting:
        if "graph" in command.get("settings", {}):
            hears = read_edge_text(command["settings"]["graph"].removeprefix("edges:"), stage.nodes)
            hears = hears.toarray()
    hears[ends] = hears[ends[::-1]] = 1
    return f"set graph={edge_text(hears)}"


def moved_node(frame: StepFrame, node: int, place: np.ndarray) -> str:
    """Return the command for a node that a hand moves to a place (3,) of the scene."""
    x, y = frame.stage.in_plane(place)
    return f"set placement={node}@{x:.1f}/{y:.1f}"
