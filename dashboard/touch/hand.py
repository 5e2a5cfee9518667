"""The hand in the scene: a menu beside a node or a link, links drawn from node to node, and nodes
moved to another place.

The menu belongs to the browser that opened it.
"""

from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

import msgspec
import numpy as np
import viser

from concord.dashboard.frames.stage import PlantDrawing
from concord.dashboard.inputs import at_once
from concord.dashboard.panels.commands import Commands
from concord.dashboard.scene.scene import Scene
from concord.dashboard.theme import Theme
from concord.dashboard.touch.actions import actions, drawn_link, moved_node
from concord.dashboard.touch.ghosts import PendingGhosts
from concord.dashboard.touch.menu import RIGHT_BUTTON, PointerMenu
from concord.dashboard.touch.picking import Picked, pick
from concord.nodes.commands import in_words

_KEEPS_ITS_PLACE = (
    "a drag ends at another node, to which it draws a link, or on the ground of a single target, "
    "where the sensor stands then"
)


class Hand:
    """Menus and drags in the scene of a network that takes commands."""

    def __init__(self, server: viser.ViserServer, scene: Scene, commands: Commands) -> None:
        self._scene, self._commands = scene, commands
        self.ghosts = PendingGhosts(server.scene)
        self._waiting: Sequence[dict[str, Any]] = ()
        self._menus: WeakKeyDictionary[viser.ClientHandle, PointerMenu] = WeakKeyDictionary()
        server.gui.add_html(RIGHT_BUTTON)
        open_at: Any = at_once(self._open_at)
        server.scene.on_click(modifier="cmd/ctrl")(open_at)
        scene.nodes.on_drag("left")(at_once(self._drag))

    def draw(self, theme: Theme, waiting: Sequence[dict[str, Any]]) -> None:
        """Show the commands that wait for the next step."""
        self._waiting, frame = waiting, self._scene.frame
        if self._scene.at is not None and frame is not None:
            self.ghosts.draw(theme, self._scene.at, self._scene.radius, frame.stage, waiting)

    def _picked(self, origin: Any, direction: np.ndarray) -> Picked | None:
        frame, at = self._scene.frame, self._scene.at
        if frame is None or at is None:
            return None
        return pick(np.array(origin), direction, at, frame.stage.edges, self._scene.radius)

    def _open_at(self, event: Any) -> None:
        picked = self._picked(event.ray_origin, np.array(event.ray_direction))
        frame = self._scene.frame
        if picked is None or frame is None:
            return
        client, names = event.client, [frame.stage.names[node] for node in picked.nodes]
        title = f"node {names[0]}" if len(names) == 1 else f"link {' – '.join(names)}"
        offered = actions(frame, picked.nodes)
        words = list(offered.values())
        self._menu_of(client).open(
            self._scene.theme, title, list(offered), lambda place: self._say(words[place], client)
        )

    def _menu_of(self, client: viser.ClientHandle) -> PointerMenu:
        if client not in self._menus:
            self._menus[client] = PointerMenu(client)
        return self._menus[client]

    def _say(self, words: str, client: viser.ClientHandle) -> None:
        command = msgspec.to_builtins(in_words(words.split()))
        self._commands.soon(self._commands.send, command, client)

    def _drag(self, event: Any) -> None:
        node, frame, at = event.instance_index, self._scene.frame, self._scene.at
        if node is None or frame is None or at is None:
            return
        if event.phase != "end":
            self.ghosts.follow(self._scene.theme, at[node], np.array(event.end_position))
            return
        self.ghosts.let_go()
        camera = np.array(event.client.camera.position)
        direction = np.array(event.end_position) - camera
        picked = self._picked(camera, direction)
        if picked is not None and len(picked.nodes) == 1:
            if picked.nodes[0] != node:
                ends = node, picked.nodes[0]
                self._say(drawn_link(frame, ends, self._waiting), event.client)
        elif frame.stage.picture is PlantDrawing.PLANE and direction[2] < 0:
            place = camera + direction * (at[node, 2] - camera[2]) / direction[2]
            self._say(moved_node(frame, node, place), event.client)
        else:
            self._commands.tell(event.client, "Refused", _KEEPS_ITS_PLACE, True)
