"""Our own HTML whose nodes can be pressed and pointed at: what a browser does there comes back
through a hidden text input beside it.

viser sends what is entered at most every 50 ms and, of all inputs of one container, only what came
last. HTML that is replaced under a pointer at rest makes the browser say again where it points. So
the text is not an event but all that there is to know, where the pointer is and what was pressed
last: whatever is left out, the newest text tells it.

It leans on viser's page (the label of an input carries its id); the version of viser is pinned, and
a browser test fails if that changes.
"""

from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import viser

from concord.dashboard.inputs import at_once

# The time makes two presses of one node two texts. A pointer does not leave what was replaced under
# it; so the element around the HTML, which stays, listens for that.
_SCRIPT = (
    "if(event.type==='pointerover')this.parentElement.onpointerleave=this.onpointerover;"
    "const e=event.target.closest('[data-node]'),n=e?e.dataset.node:'',"
    "i=document.querySelector('label[for=&quot;%s&quot;]').closest('.mantine-Flex-root')"
    ".querySelector('input'),b=i.bridge??={pointed:'',pressed:'',sent:' '};"
    "if(event.type!=='pointerdown')b.pointed=n;else if(e)b.pressed=n+'@'+Date.now();"
    "const text=b.pointed+' '+b.pressed;if(text!==b.sent){b.sent=text;"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(i,text);"
    "i.dispatchEvent(new Event('input',{bubbles:true}))}"
)


class Bridge:
    """A panel of HTML in which whatever has `data-node` is a node.

    `pick(node)` is called for a press, `point(node)` for a node that the pointer comes to and
    `point(None)` when it leaves; both in viser's event loop.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        nodes: int,
        pick: Callable[[int], None],
        point: Callable[[int | None], None],
    ) -> None:
        self._pick, self._point = pick, point
        # The browser of the last press.
        self.client: viser.ClientHandle | None = None
        self._nodes = {str(node): node for node in range(nodes)}
        self._pressed: WeakKeyDictionary[viser.ClientHandle, str] = WeakKeyDictionary()
        self._content = ""
        self._html: Any = gui.add_html("")
        self._text: Any = gui.add_text("bridge", "")
        identity = self._text._impl.uuid
        gui.add_html(
            f'<style>div:has(>.mantine-Flex-root label[for="{identity}"]){{display:none}}</style>'
        )
        script = _SCRIPT % identity
        self._frame = "<div" + "".join(
            f' on{what}="{script}"' for what in ("pointerdown", "pointerover")
        )
        self._text.on_update(at_once(self._hear))

    @property
    def content(self) -> str:
        """Return the HTML, as that of viser's handles."""
        return self._content

    @content.setter
    def content(self, html: str) -> None:
        self._content = html
        self._html.content = f"{self._frame}>{html}</div>"

    def _hear(self, event: Any) -> None:
        # Every user who can open the page can write any text here.
        pointed, _, pressed = self._text.value.partition(" ")
        node = self._nodes.get(pressed.partition("@")[0])
        if node is not None and self._pressed.get(event.client) != pressed:
            self._pressed[event.client] = pressed
            self.client = event.client
            self._pick(node)
        self._point(self._nodes.get(pointed))
