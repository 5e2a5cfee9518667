"""A menu at the pointer, as HTML of our own: panels in the scene fail to load in this viser.

A press of the right button that does not move becomes one of the left button with Ctrl, because
viser tells of no press of the right button. The menu is a popover, so a press elsewhere closes it.
"""

from collections.abc import Callable, Sequence
from html import escape
from itertools import count

import viser

from concord.dashboard.bridge import Bridge
from concord.dashboard.theme import Theme, css

_MOST_ENTRIES = 12
RIGHT_BUTTON = (
    '<img src="data:," alt="" style="display:none" onerror="'
    "if(!window.concordHand){window.concordHand=1;let began=null;"
    "const again=(type,e)=>e.target.dispatchEvent(new (type==='click'?MouseEvent:PointerEvent)("
    "type,{bubbles:true,cancelable:true,composed:true,isPrimary:true,pointerId:e.pointerId,"
    "pointerType:'mouse',button:0,buttons:type==='pointerdown'?1:0,ctrlKey:true,"
    "clientX:e.clientX,clientY:e.clientY}));"
    "document.addEventListener('pointerdown',e=>{"
    "began=e.button===2&&e.target.tagName==='CANVAS'?e:null},true);"
    "document.addEventListener('pointerup',e=>{const from=began;began=null;"
    "if(e.target.tagName==='CANVAS')window.concordAt=[e.clientX,e.clientY];"
    "if(!from||e.button!==2||Math.hypot(e.clientX-from.clientX,e.clientY-from.clientY)>4)return;"
    "setTimeout(()=>{for(const type of ['pointerdown','pointerup','click'])again(type,e)},30)},"
    'true)}">'
)
_OPEN = (
    "const m=this.parentElement,[x,y]=window.concordAt;m.showPopover();"
    "m.style.left=Math.min(x+6,innerWidth-m.offsetWidth-4)+'px';"
    "m.style.top=Math.min(y+6,innerHeight-m.offsetHeight-4)+'px'"
)


class PointerMenu:
    """The menu of one browser."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._choose: Callable[[int], None] = lambda _: None
        self._numbers = count()
        self._html = Bridge(client.gui, _MOST_ENTRIES, self._pressed, lambda _: None)

    def open(
        self, theme: Theme, title: str, entries: Sequence[str], choose: Callable[[int], None]
    ) -> None:
        """Show the entries where the pointer was pressed; `choose(i)` is called for a press."""
        self._choose = choose
        button = (
            f"display:block;width:100%;text-align:left;border:0;background:none;color:inherit;"
            f"font:inherit;padding:4px 12px;cursor:pointer;border-top:1px solid {css(theme.faint)}"
        )
        rows = "".join(
            f'<button data-node="{place}" style="{button}">{escape(entry)}</button>'
            for place, entry in enumerate(entries)
        )
        self._html.content = (
            f'<div popover="auto" data-testid="menu" data-number="{next(self._numbers)}" style="'
            f"position:fixed;inset:auto;margin:0;padding:0 0 4px;min-width:130px;font-size:13px;"
            f"border:1px solid {css(theme.quiet)};border-radius:6px;color:{css(theme.text)};"
            f'background:{css(theme.panel)}"><b style="display:block;padding:4px 12px">'
            f'{escape(title)}</b>{rows}<img src="data:," alt="" style="display:none" '
            f'onerror="{_OPEN}"></div>'
        )

    def close(self) -> None:
        """Show no menu."""
        self._html.content = ""

    def _pressed(self, place: int) -> None:
        self.close()
        self._choose(place)
