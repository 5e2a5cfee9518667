"""From our own HTML back to Python: a hidden text input that presses in SVG and tables write to.

It leans on viser's page (the label of an input carries its id); the version of viser is pinned, and
a browser test fails if that changes.
"""

from collections.abc import Callable
from typing import Any

import viser

_SCRIPT = (
    "const e=event.target.closest('[data-node]');if(e){const i=document.querySelector("
    "'label[for=&quot;%s&quot;]').closest('.mantine-Flex-root').querySelector('input');"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(i,"
    "'%s:'+e.dataset.node+':'+Date.now());i.dispatchEvent(new Event('input',{bubbles:true}))}"
)


class Bridge:
    """The way back; `press` and `hover` are attribute values for our HTML."""

    def __init__(
        self,
        gui: viser.GuiApi,
        nodes: int,
        pick: Callable[[int], None],
        point: Callable[[int], None],
    ) -> None:
        self._nodes, self._does = nodes, {"pick": pick, "point": point}
        self._text: Any = gui.add_text("bridge", "")
        identity = self._text._impl.uuid
        gui.add_html(
            f'<style>.mantine-Flex-root:has(label[for="{identity}"]){{display:none}}</style>'
        )
        self.press = _SCRIPT % (identity, "pick")
        self.hover = _SCRIPT % (identity, "point")
        self._text.on_update(self._hear)

    def _hear(self, event: Any) -> None:
        if event.client is None:
            return
        what, _, rest = self._text.value.partition(":")
        number = rest.partition(":")[0]
        # Anybody who can open the page can write anything here.
        if what in self._does and number.isdecimal() and int(number) < self._nodes:
            self._does[what](int(number))
