"""The hand in the scene: a menu beside a node or a link, and links drawn from node to node.

The menu belongs to the browser that opened it.
"""

from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

import msgspec
import numpy as np
import viser

from concord.dashboard.inputs import at_once
from concord.dashboard.panels.commands import Commands
from concord.dashboard.scene.scene import Scene
from concord.dashboard.theme import Theme
from concord.dashboard.touch.actions import actions, drawn_link
from concord.dashboard.touch.ghosts import PendingGhosts
from concord.dashboard.touch.menu import RIGHT_BUTTON, PointerMenu
from concord.dashboard.touch.picking import Picked, pick
from concord.nodes.commands import in_words

_KEEPS_ITS_PLACE = (
    "a drag draws a link, and ends at another node; a node keeps its place, because the plant "
    "makes its readings from there"
)


_NO_EDGES = np.zeros((0, 2), dtype=np.int64)


class Hand:
    """Menus and drags in the scene of a network that takes commands."""

    def __init__(self, server: viser.ViserServer, scene: Scene, commands: Commands) -> None:
        self._scene, self._commands = scene, commands
        self.ghosts = PendingGhosts(server.scene)
        self._menus: WeakKeyDictionary[viser.ClientHandle, PointerMenu] = WeakKeyDictionary()
        server.gui.add_html(RIGHT_BUTTON)
        open_at: Any = at_once(self._open_at)
        server.scene.on_click(modifier="cmd/ctrl")(open_at)
        scene.nodes.on_drag("left")(at_once(self._drag))

    def draw(self, theme: Theme, waiting: Sequence[dict[str, Any]]) -> None:
        """Show the commands that wait for the next step."""
        if self._scene.at is not None:
            frame = self._scene.frame
            edges = _NO_EDGES if frame is None else frame.stage.edges
            self.ghosts.draw(theme, self._scene.at, self._scene.radius, edges, waiting)

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
        picked = self._picked(camera, np.array(event.end_position) - camera)
        if picked is None or len(picked.nodes) != 1:
            self._commands.tell(event.client, "Refused", _KEEPS_ITS_PLACE, True)
        elif picked.nodes[0] != node:
            self._say(drawn_link(frame, (node, picked.nodes[0])), event.client)
