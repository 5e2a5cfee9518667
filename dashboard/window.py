"""The window of the page: viser's server with its theme, camera, keys and notifications."""

import contextlib
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from weakref import WeakKeyDictionary
from zipfile import ZipFile

import numpy as np
import rich
import viser
from viser import _icons

from concord.dashboard.access import PageAccess
from concord.dashboard.inputs import at_once
from concord.dashboard.layout import Panels
from concord.dashboard.scene.camera import FIELD_OF_VIEW_RAD, Camera, Free, aimed
from concord.dashboard.scene.scene import Scene
from concord.dashboard.theme import Theme
from concord.dashboard.viewport import Viewports

_AIR = 0.15
_FIRST_SIZE = (1600, 900)


@cache
def _archive(path: Path) -> AbstractContextManager[ZipFile]:
    """Return an archive that stays open."""
    return nullcontext(ZipFile(path))


# viser reads the directory of 4,285 icons again for each icon: 20 ms for each button.
_viser_icons: Any = _icons
_viser_icons.zipfile = SimpleNamespace(ZipFile=_archive)


class PageServer:
    """A server of one page; every client sees the same."""

    def __init__(self, host: str, port: int) -> None:
        # viser prints a banner; this process prints one line of its own.
        rich.get_console().quiet = True
        self.access = PageAccess(host)
        with self.access.guarding():
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self._label = ""
        self.label("concord")
        self._scene: Scene | None = None
        self._target: np.ndarray | None = None
        # The places of the target so far, as corners of a box in the scene.
        self._course = np.zeros((0, 3))
        self._free: WeakKeyDictionary[viser.ClientHandle, Free] = WeakKeyDictionary()
        self._sizes: WeakKeyDictionary[viser.ClientHandle, tuple[int, int]] = WeakKeyDictionary()
        self._presenting: WeakKeyDictionary[viser.ClientHandle, Any] = WeakKeyDictionary()
        self._aims: WeakKeyDictionary[viser.ClientHandle, Camera] = WeakKeyDictionary()

    @property
    def url(self) -> str:
        """Return the address of the page, with its token."""
        host = self.server.get_host()
        place = f"[{host}]" if ":" in host else host
        return f"http://{place}:{self.server.get_port()}/?token={self.access.token}"

    def label(self, word: str) -> None:
        """Write a word above the controls; a small window shows it in place of the controls."""
        if word != self._label:
            self._label = word
            self.server.gui.set_panel_label(word)

    def set_theme(self, theme: Theme) -> None:
        """Repaint the widgets of viser."""
        self.server.gui.configure_theme(
            dark_mode=theme.dark,
            show_logo=False,
            show_share_button=False,
            brand_color=(62, 150, 214) if theme.dark else (0, 114, 178),
        )

    def aim(self, scene: Scene, panels: Panels) -> None:
        """Arrange the panels of each client for its window, and aim its camera at the rest."""
        camera, (width, height) = self.server.initial_camera, _FIRST_SIZE
        camera.position, camera.look_at = aimed(
            scene.extent(), Free(width, height, 0, 0, width, height)
        )
        camera.fov = FIELD_OF_VIEW_RAD

        self._scene = scene

        def arrange(client: viser.ClientHandle, width: int, height: int) -> None:
            self._sizes[client] = width, height
            presents = client in self._presenting
            self._free[client] = panels.arrange(client, width, height, presents)
            self._aim_first(client)

        self._arrange = arrange
        # A small window minimizes the column of the controls, and a phone all but that column.
        Viewports(self.server.gui, (nullcontext(), panels.bus), arrange)
        # Before a client has told of its camera, the camera cannot be turned.
        self.server.on_client_connect(self._aim_first)

    def _aim_first(self, client: viser.ClientHandle) -> None:
        """Aim a camera at the whole map, unless its user has turned it."""
        if self._scene is None or client not in self._free:
            return
        with contextlib.suppress(AssertionError):
            if client not in self._aims or _stands(client, self._aims[client]):
                self._turn(client, aimed(self._whole(self._scene), self._free[client]))

    def _whole(self, scene: Scene) -> np.ndarray:
        return np.concatenate([scene.extent(), self._course])

    def keep_in_sight(self, target: np.ndarray | None) -> None:
        """Aim the cameras again that no user has turned, where the target (3,) leaves the map."""
        if self._scene is None or target is None or not np.isfinite(target).all():
            return
        points = self._whole(self._scene)
        low, high = points.min(axis=0), points.max(axis=0)
        if ((low <= target) & (target <= high))[:2].all():
            return
        # Some air, so that the next steps do not move the cameras again.
        away = _AIR * (target - (low + high) / 2)
        self._course = np.concatenate(
            [self._course[-50:], [target, target + away * np.array([1, 1, 0])]]
        )
        for client in self.server.get_clients().values():
            self._aim_first(client)

    def free(self, client: viser.ClientHandle) -> Free | None:
        """Return the part of a client's window that its panels leave to the scene, if known."""
        return self._free.get(client)

    def restore(self, client: viser.ClientHandle) -> None:
        """Put all panels of a client where they were at first, and aim its camera."""
        if client in self._sizes:
            self._arrange(client, *self._sizes[client])
            self.fit(client)

    def present(self, client: viser.ClientHandle) -> None:
        """Show a client the scene, the bus, one chart and the verdict in large letters, without
        controls; or the whole page again."""
        style = self._presenting.pop(client, None)
        if style is not None:
            style.remove()
        else:
            # The shell of the page looks for this mark.
            mark = '<i class="concord-present" hidden></i>'
            self._presenting[client] = client.gui.add_html(mark)
        self.restore(client)

    def fit(self, client: viser.ClientHandle) -> None:
        """Aim a client's camera at all that the scene shows now, also outside of the map."""
        if self._scene is not None and client in self._free:
            points = np.concatenate([self._scene.extent(), self._scene.shown])
            self._turn(client, aimed(points, self._free[client]))

    def follow(self, target: np.ndarray | None) -> None:
        """Move all cameras as the target (3,) has moved since the last call; None ends it."""
        last, self._target = self._target, target
        if target is None or last is None or np.allclose(target, last):
            return
        for client in self.server.get_clients().values():
            with contextlib.suppress(AssertionError):
                # The point that is looked at moves with the position.
                client.camera.position = client.camera.position + (target - last)

    def _turn(self, client: viser.ClientHandle, camera: Camera) -> None:
        client.camera.position, client.camera.look_at = camera
        self._aims[client] = camera

    def bind(self, label: str, key: Any, act: Callable[[Any], None]) -> None:
        """Call `act(client)` in viser's event loop when a person presses a key."""
        command = self.server.gui.add_command(label, hotkey=key)
        command.on_trigger(at_once(lambda event: act(event.client)))

    def tell(self, client: Any, title: str, body: str, is_trouble: bool) -> None:
        """Show a short message to a client, or to all clients when `client` is None."""
        clients = [client] if client is not None else list(self.server.get_clients().values())
        for one in clients:
            one.add_notification(
                title, body, auto_close_seconds=8.0 if is_trouble else 3.0,
                color="red" if is_trouble else "green",
            )  # fmt: skip


def _stands(client: viser.ClientHandle, camera: Camera) -> bool:
    """Say whether a client's camera still is where it was aimed."""
    return bool(np.allclose(client.camera.position, camera.position, atol=1e-3))
