"""Sizes of the browsers' windows: each page reports its own, at first and when it is resized.

viser knows the size of the canvas, which the docked panels make smaller than the window. The text
comes back through a hidden input, as in `bridge.py`.
"""

from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import viser

from concord.dashboard.inputs import at_once

# No window is larger; a person who can open the page can write any text here.
_MOST_PIXELS = 20_000
# An image without a source fails to load as soon as it is there. A window that is being resized is
# reported once it rests. The newest image alone listens: after a reconnection there is another.
_SCRIPT = (
    "const tell=()=>{const i=[%s].map(id=>document.querySelector(`label[for=&quot;${id}&quot;]`))"
    ".find(label=>label)?.closest('.mantine-Flex-root').querySelector('input');"
    "if(!i||window.concordSize!==tell)return;"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(i,"
    "innerWidth+' '+innerHeight+' '+Date.now());"
    "i.dispatchEvent(new Event('input',{bubbles:true}))};window.concordSize=tell;"
    "let rest;window.addEventListener('resize',()=>{clearTimeout(rest);rest=setTimeout(tell,250)});"
    "tell()"
)


class Viewports:
    """Calls `resized(client, width, height)` in viser's event loop for each new size in pixels.

    viser does not mount what is in a minimized panel; so `containers` are several panels of which
    one is open.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        containers: Sequence[Any],
        resized: Callable[[viser.ClientHandle, int, int], None],
    ) -> None:
        self._resized = resized
        self._sizes: WeakKeyDictionary[viser.ClientHandle, tuple[int, int]] = WeakKeyDictionary()
        texts: list[Any] = []
        for container in containers:
            with container:
                texts.append(gui.add_text("viewport", ""))
        identities = [text._impl.uuid for text in texts]
        script = _SCRIPT % ",".join(f"'{identity}'" for identity in identities)
        for container, text, identity in zip(containers, texts, identities, strict=True):
            with container:
                gui.add_html(
                    f'<style>div:has(>.mantine-Flex-root label[for="{identity}"])'
                    # In a window below viser's breakpoint its column is narrower than the window.
                    "{display:none}@media(max-width:36em){"
                    "div[style*='width: 20em']{width:100%!important}}</style>"
                    f'<img src="data:," style="display:none" onerror="{script}">'
                )
            text.on_update(at_once(self._hear))

    def _hear(self, event: Any) -> None:
        # Every user who can open the page can write any text here.
        numbers = event.target.value.split()[:2]
        if len(numbers) == 2 and all(number.isdecimal() for number in numbers):
            width, height = (int(number[:6]) for number in numbers)
            if 0 < width <= _MOST_PIXELS and 0 < height <= _MOST_PIXELS:
                self._take(event.client, width, height)

    def _take(self, client: viser.ClientHandle, width: int, height: int) -> None:
        """Pass a client's size on unless it is known."""
        if self._sizes.get(client) != (width, height):
            self._sizes[client] = (width, height)
            self._resized(client, width, height)
