"""One cursor for all charts and the strip of the run: a pointer on one of them marks its time in
all, and a press in a chart shows that step.

uPlot shares the cursor among the charts. This script, which runs in the browser, also carries it
to and from the strip, and tells of presses through a hidden input, as in `bridge.py`. It finds the
plots where viser registers them; the version of viser is pinned, and a browser test fails if that
changes.
"""

from collections.abc import Callable
from typing import Any

import viser

from concord.dashboard.inputs import at_once

SYNC: Any = {"sync": {"key": "time", "scales": ["x", None]}}
"""Option `cursor` of the plots that share it."""

# Beside its mark, a line is named while no pointer is there, and has its value while one is. A
# single line is named by the title, at whose right its value stands.
READING_STYLE = (
    "<style>.u-legend th::after{content:none!important}.u-legend .u-value{color:inherit!important}"
    ".u-legend tr.u-series:first-child,.u-legend .u-value,"
    ".u-legend:has(tr:nth-child(2):last-child) tr{display:none!important}"
    "body:has(.u-over:hover,.bin:hover){.u-legend .u-value{display:inline!important;"
    "min-width:38px!important;text-align:left!important}"
    ".u-legend .u-label{display:none!important}"
    ".u-legend:has(tr:nth-child(3)) tr:first-child,"
    ".u-legend:has(tr:nth-child(2):last-child) tr:nth-child(2){display:inline-block!important}"
    '.u-legend tr:first-child .u-value::after{content:" s"}}'
    ".u-legend:has(tr:nth-child(2):last-child){position:absolute;top:3px;right:28px;"
    "width:auto!important}</style>"
)

# An image without a source fails to load as soon as it is there. After a reconnection there is
# another, so listeners look for the newest input. A press that drags zooms, and seeks nothing.
_SCRIPT = (
    "window.concordTime='%s';if(!window.concordCursor){window.concordCursor=1;"
    "const plots=()=>Object.values(window.__viserTestpoints?.uplots??{}).map(p=>p.chart),"
    "of=over=>plots().find(u=>u.over===over),"
    "timeOf=(u,e)=>u.posToVal(e.clientX-u.over.getBoundingClientRect().left,'x'),"
    "strip=t=>{const run=document.querySelector('[data-testid=run]'),"
    "mark=run?.querySelector('[data-testid=run-pointer]');if(!mark)return;"
    "const bin=t===null?null:[...run.querySelectorAll('.bin')].findLast(b=>+b.dataset.time<=t);"
    "mark.setAttribute('visibility',bin?'visible':'hidden');if(bin)"
    "mark.setAttribute('transform',`translate(${+bin.getAttribute('x')+bin.getAttribute('width')/2})`)"
    "},"
    "charts=t=>plots().forEach(u=>{const inside=t!==null&&t>=u.scales.x.min&&t<=u.scales.x.max;"
    "u.setCursor(inside?{left:u.valToPos(t,'x'),top:u.over.clientHeight/2}:{left:-10,top:-10},"
    "true,false)});"
    "const say=text=>{const i=document.querySelector("
    "`label[for=&quot;${window.concordTime}&quot;]`)?.closest('.mantine-Flex-root')"
    ".querySelector('input');if(!i)return;"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(i,text);"
    "i.dispatchEvent(new Event('input',{bubbles:true}))},"
    "step=new URLSearchParams(location.search).get('step');"
    "if(step)setTimeout(()=>say('step '+step),300);let began=null;"
    "document.addEventListener('pointermove',e=>{const over=e.target.closest?.('.u-over'),"
    "bin=e.target.closest?.('.bin');"
    "if(over){const u=of(over);if(u)strip(timeOf(u,e))}"
    "else{strip(null);if(bin){charts(+bin.dataset.time);window.concordPointed=1}"
    "else if(window.concordPointed){charts(null);window.concordPointed=0}}});"
    "document.addEventListener('pointerdown',e=>{began=e.target.closest?.('.u-over')?e:null},true);"
    "document.addEventListener('pointerup',e=>{const over=e.target.closest?.('.u-over');"
    "if(!began||!over||e.button||Math.hypot(e.clientX-began.clientX,e.clientY-began.clientY)>4)"
    "return;const u=of(over);if(u)say(timeOf(u,e)+' '+Date.now())},true)}"
)


class TimeCursor:
    """Calls `seek(time_s)` in viser's event loop for each press in a chart.

    An address with `step=40` calls `seek_step(40)` when its page opens.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        seek: Callable[[float], None],
        seek_step: Callable[[int], None],
    ) -> None:
        self._seek, self._seek_step = seek, seek_step
        text: Any = gui.add_text("time", "")
        identity = text._impl.uuid
        gui.add_html(
            f'<style>div:has(>.mantine-Flex-root label[for="{identity}"]){{display:none}}</style>'
            f'<img src="data:," style="display:none" onerror="{_SCRIPT % identity}">'
        )
        text.on_update(at_once(self._hear))

    def _hear(self, event: Any) -> None:
        # Every user who can open the page can write any text here.
        words = event.target.value[:60].split()
        try:
            if words[0] == "step":
                self._seek_step(max(0, int(words[1][:9])))
            else:
                self._seek(float(words[0]))
        except (ValueError, IndexError):
            return
