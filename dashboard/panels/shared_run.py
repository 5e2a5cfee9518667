"""A run as one page without a network: scene, bus and charts that scrub together.

The scene is viser's own playback. A script beside it reads the time of the playback and shows the
bus of that step and a cursor in all charts; a press in a chart moves the playback. With `?step=40`
in its address the page opens at that step.
"""

import json
from collections.abc import Sequence
from html import escape

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Curve, Drawn, known_pieces
from concord.dashboard.panels.timeline import TimelineView, past_cycles
from concord.dashboard.theme import Theme, css
from concord.dashboard.view import View

FRAME_S = 0.1
"""Time of a frame in the playback, in seconds: viser shows its time with one decimal."""
_WIDTH, _HEIGHT, _LEFT, _TOP = 380.0, 118.0, 44.0, 18.0
_SIDE_PX, _BUS_PX = 400, 250
_SCRIPT = """
const run=JSON.parse(document.getElementById('run').textContent);
const side=document.querySelector('aside');
const bus=document.getElementById('bus'),told=document.getElementById('told');let shown=-1;
const bar=()=>document.querySelector('#root [role=slider]');
const charts=[...side.querySelectorAll('svg')];
const place=(chart,time)=>{const [first,last]=chart.dataset.span.split(' ').map(Number);
  return LEFT+(WIDTH-LEFT-8)*(time-first)/(last-first||1)};
function show(index){if(index===shown)return;shown=index;bus.innerHTML=run.bus[index];
  told.textContent=run.told[index];
  for(const chart of charts){const x=place(chart,run.times[index]);
    const line=chart.querySelector('.cursor');
    line.setAttribute('x1',x);line.setAttribute('x2',x)}}
function seek(index){const input=[...document.querySelectorAll('#root input')].find(
    one=>/^[0-9.]+$/.test(one.value));if(!input)return;
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(
    input,String((index+0.5)*FRAME));
  input.dispatchEvent(new Event('input',{bubbles:true}))}
const nearest=(list,value)=>list.reduce((best,one,i)=>
  Math.abs(one-value)<Math.abs(list[best]-value)?i:best,0);
side.addEventListener('click',e=>{const chart=e.target.closest('svg');if(!chart)return;
  const box=chart.getBoundingClientRect(),[first,last]=chart.dataset.span.split(' ').map(Number);
  const share=((e.clientX-box.x)/box.width*WIDTH-LEFT)/(WIDTH-LEFT-8);
  seek(nearest(run.times,first+share*(last-first)))});
let wanted=new URLSearchParams(location.search).get('step');
setInterval(()=>{const now=bar();if(!now)return;
  if(wanted!==null){const step=wanted;wanted=null;seek(nearest(run.steps,Number(step)));return}
  const index=Math.floor(Number(now.getAttribute('aria-valuenow'))/FRAME+1e-6);
  show(Math.min(index,run.times.length-1))},50);
"""


def shared_run(
    scene: str, stage: Stage, view: View, frames: Sequence[Sequence[StepFrame]],
    charts: Sequence[Drawn],
) -> str:  # fmt: skip
    """Return the page of an animated scene with bus and charts.

    Each entry of `frames` ends with a frame of the animation; the others are the steps before it.
    """
    theme, timeline = view.theme, TimelineView(stage)
    buses = []
    for past in frames:
        frame = past[-1]
        cycle = frame.cycles[-1]
        before = past_cycles(past, cycle)
        buses.append(timeline.draw(theme, frame, before, cycle, 0.0, view.selected))
    last = [past[-1] for past in frames]
    data = {
        "steps": [frame.step for frame in last],
        "times": [frame.time_s for frame in last],
        "told": [_told(frame) for frame in last],
        "bus": buses,
    }
    drawn = "".join(chart_svg(theme, chart) for chart in charts if _known(chart))
    names = {"WIDTH": _WIDTH, "LEFT": _LEFT, "FRAME": FRAME_S}
    constants = "".join(f"const {name}={value:g};" for name, value in names.items())
    # No text of a run can end the element that holds it.
    kept = json.dumps(data).replace("</", "<\\/")
    beside = (
        f"<style>#root{{position:fixed!important;inset:0 {_SIDE_PX}px {_BUS_PX}px 0;width:auto;"
        f"height:auto;transform:translateZ(0)}}#root>div{{width:100%!important;"
        f"height:100%!important}}aside,footer{{position:fixed;background:{css(theme.panel)};"
        f"color:{css(theme.text)};font:12px sans-serif;overflow:auto;padding:6px 10px;"
        f"box-sizing:border-box}}aside{{inset:0 0 0 auto;width:{_SIDE_PX}px}}"
        f"footer{{inset:auto {_SIDE_PX}px 0 0;height:{_BUS_PX}px}}aside svg{{cursor:crosshair}}"
        f'</style><aside><p id="told" data-testid="told"></p>{drawn}</aside>'
        f'<footer id="bus"></footer><script type="application/json" id="run">{kept}</script>'
        f"<script>{constants}{_SCRIPT}</script>"
    )
    end = scene.rindex("</body>")
    return scene[:end] + beside + scene[end:]


def _told(frame: StepFrame) -> str:
    scores, unit = frame.scores, frame.stage.score.unit.removeprefix("1")
    name = frame.stage.error_name
    rmse = f", {name} {rounded(scores.rmse)} {unit}".rstrip() if np.isfinite(scores.rmse) else ""
    alive = f"{int(frame.alive.sum())} of {frame.stage.nodes} nodes up"
    return f"step {frame.step}, time {frame.time_s:.4g} s, {alive}{rmse}"


def _known(chart: Drawn) -> bool:
    return any(np.isfinite(curve.values).any() for curve in chart.curves)


def chart_svg(theme: Theme, chart: Drawn) -> str:
    """Return a chart as SVG with a cursor, and the names of its curves."""
    curves = [curve for curve in chart.curves if np.isfinite(curve.values).any()]
    values = [_scaled(curve, chart.is_logarithmic) for curve in curves]
    low = min(0.0 if not chart.is_logarithmic else np.inf, *(np.nanmin(one) for one in values))
    high = max(np.nanmax(one) for one in values)
    span = (high - low) or 1.0
    first, last = float(chart.times[0]), float(chart.times[-1])
    x = _LEFT + (_WIDTH - _LEFT - 8) * (chart.times - first) / ((last - first) or 1.0)
    bottom = _HEIGHT - 16
    lines = []
    for curve, one in zip(curves, values, strict=True):
        y = bottom - (bottom - _TOP) * (one - low) / span
        path = "M".join(
            "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[s], y[s], strict=True))
            for s in known_pieces(y)
        )
        dash = ' stroke-dasharray="5 4"' if curve.dashed else ""
        lines.append(f'<path d="M{path}" fill="none" stroke="{css(curve.colour)}"{dash}/>')
    ends = [10.0**one if chart.is_logarithmic else one for one in (high, low)]
    quiet = css(theme.quiet)
    words = "".join(
        f'<text x="{a:g}" y="{b:g}" font-size="10" fill="{quiet}" text-anchor="{anchor}">{text}'
        "</text>"
        for a, b, anchor, text in (
            (_LEFT - 4, _TOP + 8, "end", f"{ends[0]:.3g}"),
            (_LEFT - 4, bottom, "end", f"{ends[1]:.3g}"),
            (_LEFT, _HEIGHT - 3, "start", f"{first:.4g}"),
            (_WIDTH - 8, _HEIGHT - 3, "end", f"{last:.4g} s"),
        )
    )
    names = ", ".join(
        f'<tspan fill="{css(curve.colour)}">{escape(curve.name)}</tspan>' for curve in curves
    )
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" width="100%" data-span="{first} {last}">'
        f'<text x="2" y="12" font-size="11" fill="{css(theme.text)}">{escape(chart.title)}: {names}'
        f'</text><path d="M{_LEFT:g} {_TOP:g}V{bottom:g}H{_WIDTH - 8:g}" fill="none" '
        f'stroke="{css(theme.faint)}"/>{words}{"".join(lines)}<line class="cursor" y1="{_TOP:g}" '
        f'y2="{bottom:g}" x1="-9" x2="-9" stroke="{css(theme.text)}"/></svg>'
    )


def _scaled(curve: Curve, is_logarithmic: bool) -> np.ndarray:
    return np.log10(np.maximum(curve.values, 1e-300)) if is_logarithmic else curve.values
