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
:is(label,[role=tab],[role=tab] *){opacity:1!important}
[data-mantine-color-scheme=dark] :is(label,[role=tab],[role=tab] *,.mantine-Slider-markLabel,
.floating-panel-handle){color:#c9ccd2!important}
[data-mantine-color-scheme=light] :is(label,[role=tab],[role=tab] *,.mantine-Slider-markLabel,
.floating-panel-handle){color:#41464f!important}
[data-mantine-color-scheme=dark] [role=tab][aria-selected=true],
[data-mantine-color-scheme=dark] [role=tab][aria-selected=true] *{color:#79c0ee!important}
[data-mantine-color-scheme=light] :is([role=tab][aria-selected=true],
[role=tab][aria-selected=true] *,.mantine-Button-root[data-variant=outline]){
color:#005a96!important}
/* All charts but the first are small; a pointer there, or viser's larger picture, names lines. */
body:not(:has(.u-over:hover,.bin:hover)) div:has(>.uplot-container)~div:has(>.uplot-container)
.u-legend{display:none!important}
/* The table has the height that its rows need, at most a half, and the charts have the rest; no
longer so once a user has drawn the line between them. */
[data-dock-scroll]>[style*="flex: 0.5 1 0px"]:has(table.nodes){flex:0 0 var(--low,50%)!important}
[data-dock-scroll]>[style*="flex: 0.5 1 0px"]:has(.uplot-container){flex:1 1 0!important}
/* Presenting: status, one chart and the bus, in letters one and a half times as large. */
.present :is(.concord-side,.concord-about),
.present .concord-controls>:not(:has(.concord-status)),
.present div:has(>.uplot-container)~div:has(>.uplot-container){display:none!important}
.present :is(.concord-status,.uplot-container){zoom:1.5}
.present [data-testid=timeline] text{font-size:18px!important}
.present .slot text{font-size:22px!important;transform:translateY(4px)}
.present [data-testid=timeline] .wide{display:none!important}
.present .bus-legend{zoom:1.35}
.present [data-testid=run] text{font-size:18px!important}
.uplot-container .u-title{min-width:200px}
.mantine-Notification-root{max-width:340px}
.mantine-Notification-description{max-height:5.5em;overflow:auto}
#concord-loading{position:fixed;inset:0;z-index:9999;background:#16181d;color:#dcdee2;display:flex;
align-items:center;justify-content:center;font:20px system-ui,sans-serif}
#concord-gone{position:fixed;z-index:9999;top:0;left:0;right:0;background:#d55e00;color:#000;
padding:10px 16px;font:600 15px system-ui,sans-serif;text-align:center}
#concord-gone[hidden]{display:none}
.concord-marks:focus-visible{outline:2px solid #d55e00;outline-offset:-2px}
#concord-spoken{position:fixed;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}
</style>"""

_SCRIPT = """<script>(()=>{
// Where a theme changes with its plots, viser makes a plot twice, and keeps the range of the first.
// uPlot gives a plot its range later, so `batch` gives it one as soon as viser registers the plot.
let points;
Object.defineProperty(window,'__viserTestpoints',{configurable:true,get:()=>points,set:value=>{
  points=value;
  points.uplots=new Proxy({...value.uplots},{set:(plots,id,plot)=>{
    plot.chart.batch(()=>{});plots[id]=plot;return true}})}});
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
  const table=document.querySelector('table.nodes'),column=table?.closest('[data-dock-scroll]');
  if(column)document.body.style.setProperty('--low',
    Math.min(table.offsetHeight+80,column.offsetHeight/2)+'px');
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
// Pictures of marks are drawn anew with each step; the element around them stays and has the focus.
const [marked,spoken]=['mark','spoken'].map(id=>document.getElementById('concord-'+id));
const around=()=>document.querySelectorAll('[data-marks]').forEach(picture=>{
  const box=picture.closest('[onpointerdown]')?.parentElement;
  if(!box||box.classList.contains('concord-marks'))return;
  box.classList.add('concord-marks');box.tabIndex=0;box.setAttribute('role','group');
  box.setAttribute('aria-label',picture.dataset.marks+'; arrows choose, Enter presses')});
setInterval(around,400);
const marksOf=box=>[...new Map([...box.querySelectorAll('[data-node]')].reverse()
  .map(mark=>[mark.dataset.node,mark]))].reverse();
const choose=(box,name,mark)=>{
  box.dataset.chosen=name;
  const at=`.concord-marks:focus [data-node="${name}"]`;
  marked.textContent=`:is(tr,td):is(${at}){outline:2px solid #d55e00;outline-offset:-2px}`+
    `${at}>:is(rect,text),:is(rect,circle):is(${at}){stroke:#d55e00;stroke-width:3}`;
  spoken.textContent=mark.querySelector('title')?.textContent??mark.innerText.replace(/\\s+/g,' ');
  if(mark.matches('tr'))mark.scrollIntoView({block:'nearest'})};
const turns={ArrowRight:1,ArrowDown:1,ArrowLeft:-1,ArrowUp:-1,Home:-1e9,End:1e9};
document.addEventListener('keydown',e=>{
  const box=e.target;
  if(!box.classList?.contains('concord-marks')||e.ctrlKey||e.altKey||e.metaKey)return;
  const marks=marksOf(box),place=marks.findIndex(([name])=>name===box.dataset.chosen);
  const last=marks.length-1;
  if(e.key in turns&&marks.length){
    const turn=turns[e.key],begin=place<0&&Math.abs(turn)===1;
    choose(box,...marks[begin?0:Math.max(0,Math.min(last,place+turn))])}
  else if(e.key==='Enter'||e.key===' ')
    marks[place]?.[1].dispatchEvent(new PointerEvent('pointerdown',{bubbles:true}));
  else return;
  e.preventDefault();e.stopPropagation();
},true);
})()</script>"""

SHELL = (
    _STYLE
    + '<div id="concord-loading" role="status">concord is loading</div>'
    + '<div id="concord-gone" role="alert" hidden></div>'
    + '<style id="concord-mark"></style><div id="concord-spoken" aria-live="polite"></div>'
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
