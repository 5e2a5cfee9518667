"""The window of the page: viser's server with its theme, camera, keys and notifications."""

import contextlib
from collections.abc import Callable
from typing import Any

import rich
import viser

from concord.dashboard.access import PageAccess
from concord.dashboard.inputs import at_once
from concord.dashboard.scene.camera import FIELD_OF_VIEW_RAD, Free, aimed
from concord.dashboard.scene.scene import Scene
from concord.dashboard.theme import Theme

_FIRST_SIZE = (1600, 900)


class PageServer:
    """A server of one page; every client sees the same."""

    def __init__(self, host: str, port: int) -> None:
        # viser prints a banner; this process prints one line of its own.
        rich.get_console().quiet = True
        self.access = PageAccess(host)
        with self.access.guarding():
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.server.gui.set_panel_label("concord")

    @property
    def url(self) -> str:
        """Return the address of the page, with its token."""
        host = self.server.get_host()
        place = f"[{host}]" if ":" in host else host
        return f"http://{place}:{self.server.get_port()}/?token={self.access.token}"

    def set_theme(self, theme: Theme) -> None:
        """Repaint the widgets of viser."""
        self.server.gui.configure_theme(
            dark_mode=theme.dark,
            show_logo=False,
            show_share_button=False,
            brand_color=(0, 114, 178),
        )

    def aim(self, scene: Scene, arrange: Callable[[int, int], Free]) -> None:
        """Aim the camera at what the panels leave free, now and for the window of each client."""
        camera = self.server.initial_camera
        camera.position, camera.look_at = aimed(scene.extent(), arrange(*_FIRST_SIZE))
        camera.fov = FIELD_OF_VIEW_RAD

        def fit(client: viser.ClientHandle) -> None:
            camera = client.camera
            with contextlib.suppress(AssertionError):
                if camera.image_width and camera.image_height:
                    free = arrange(camera.image_width, camera.image_height)
                    camera.position, camera.look_at = aimed(scene.extent(), free)

        self.server.on_client_connect(fit)

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
