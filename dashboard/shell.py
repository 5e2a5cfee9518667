"""Shell of the page: what a browser shows before viser's parts, around them, and after their end.

viser serves one HTML file and has no option for its title, its first picture, or the loss of its
connection. So `PageAccess` adds this text to that file.
"""

import gzip
from functools import cache

from websockets.http11 import Response

ALIVE = "/alive"
"""Address that a page asks to learn whether its program is there."""

_STYLE = """<style>
/* The developers' panel of viser: an address of the server, tools that move the scene. */
button:has(.tabler-icon-adjustments){display:none!important}
/* Contrast of labels and tabs: at least 4.5 to 1. */
:is(label,.mantine-Tabs-tab){opacity:1!important}
[data-mantine-color-scheme=dark] :is(label,.mantine-Tabs-tab){color:#c9ccd2!important}
[data-mantine-color-scheme=light] :is(label,.mantine-Tabs-tab){color:#41464f!important}
/* All charts but the first are small; a pointer there, or viser's larger picture, names lines. */
body:not(:has(.u-over:hover,.bin:hover)) div:has(>.uplot-container)~div:has(>.uplot-container)
.u-legend{display:none!important}
/* Presenting: status, one chart and the bus, in letters one and a half times as large. */
.present :is(.concord-side,.concord-about),
.present .concord-controls>:not(:has(.concord-status)),
.present div:has(>.uplot-container)~div:has(>.uplot-container){display:none!important}
.present :is(.concord-status,.uplot-container){zoom:1.5}
.present [data-testid=timeline] text{font-size:16px!important}
.uplot-container .u-title{min-width:200px}
.mantine-Notification-root{max-width:340px}
.mantine-Notification-description{max-height:5.5em;overflow:auto}
#concord-loading{position:fixed;inset:0;z-index:9999;background:#16181d;color:#dcdee2;display:flex;
align-items:center;justify-content:center;font:20px system-ui,sans-serif}
#concord-gone{position:fixed;z-index:9999;top:0;left:0;right:0;background:#d55e00;color:#000;
padding:10px 16px;font:600 15px system-ui,sans-serif;text-align:center}
#concord-gone[hidden]{display:none}
</style>"""

_SCRIPT = """<script>(()=>{
const [loading,gone]=['loading','gone'].map(id=>document.getElementById('concord-'+id));
let heard=Date.now(),wasGone=false;
const look=()=>{
  const told=[...document.querySelectorAll('.concord-told')].pop();
  if(told||document.querySelector('[data-testid]'))loading.remove();
  if(told)document.title=told.dataset.title;
  const presents=!!document.querySelector('.concord-present');
  document.body.classList.toggle('present',presents);
  document.querySelectorAll('.concord-side').forEach(e=>e.classList.remove('concord-side'));
  if(presents)document.querySelectorAll('[role=tab]').forEach(tab=>{
    if(!/Nodes|Beliefs/.test(tab.textContent))return;
    let panel=tab;
    while(panel&&!/absolute|fixed/.test(getComputedStyle(panel).position))panel=panel.parentElement;
    if(panel&&panel.id!=='root'&&!panel.querySelector('.uplot-container,canvas,.concord-status'))
      panel.classList.add('concord-side')});
  let part=document.querySelector('.concord-status');
  while(part&&part.parentElement.childElementCount<2)part=part.parentElement;
  part?.parentElement.classList.add('concord-controls');
  document.querySelectorAll('button:not([aria-label])').forEach(b=>{
    if(!b.textContent.trim())b.setAttribute('aria-label',
      b.querySelector('.tabler-icon-search,.tabler-icon-command')?'commands and keys':'panel')});
};
const since=()=>`No connection to concord since ${new Date(heard).toLocaleTimeString()} `+
  `(${Math.round((Date.now()-heard)/1000)} s). The picture stands still. `+
  'Start concord again; where it has the same address, this page loads by itself.';
const ask=()=>fetch('/alive',{cache:'no-store',signal:AbortSignal.timeout(4000)}).then(answer=>{
  // A program that was only busy keeps the page as it is.
  if(wasGone&&answer.ok)location.reload();
  if(answer.ok){heard=Date.now();gone.hidden=true}},
  error=>{wasGone||=error.name==='TypeError'}).then(()=>{
  if(Date.now()-heard>8000){gone.hidden=false;gone.textContent=since()}});
setInterval(look,400);setInterval(ask,1500);
document.addEventListener('keydown',e=>{
  const at=e.target.closest?.('[data-node][tabindex]');
  if(!at||(e.key!=='Enter'&&e.key!==' '))return;
  e.preventDefault();
  at.dispatchEvent(new PointerEvent('pointerdown',{bubbles:true}));
});
})()</script>"""

SHELL = (
    _STYLE
    + '<div id="concord-loading" role="status">concord is loading</div>'
    + '<div id="concord-gone" role="alert" hidden></div>'
    + _SCRIPT
)


def with_shell(response: Response) -> Response:
    """Add the shell to a response that is viser's page; return all others as they are."""
    if not response.headers.get("Content-Type", "").startswith("text/html"):
        return response
    body = bytes(response.body)
    is_packed = response.headers.get("Content-Encoding") == "gzip"
    response.body = _added(body, is_packed)
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    return response


@cache
def _added(body: bytes, is_packed: bool) -> bytes:
    html = gzip.decompress(body) if is_packed else body
    # Behind the end of the body a browser still takes elements into the body.
    html += SHELL.encode()
    return gzip.compress(html, 6) if is_packed else html
