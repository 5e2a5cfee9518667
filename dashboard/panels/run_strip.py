"""The whole run as one strip: RMSE, events and missed frames; a press seeks the step."""

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.frames.frame import LogEntry
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.timeline_marks import LEFT, RIGHT, WIDTH, readable
from concord.dashboard.theme import Theme, css, mixed
from concord.dashboard.view import View

MOST_BINS = 120
_HEIGHT, _TOP, _BOTTOM, _HEAT = 56.0, 12.0, 42.0, 8.0


class RunBins(NamedTuple):
    """The steps of a run in bins: the first step of each (B + 1,), root mean square of RMSE (B,),
    frames missed (B,); RMSE is NaN where the truth is unknown."""

    edges: np.ndarray
    rmse: np.ndarray
    missed: np.ndarray


class RunStrip:
    """Keeps two numbers of each step, so that a picture does not cost the length of the run."""

    def __init__(self) -> None:
        self._steps: list[int] = []
        self._rmse: list[float] = []
        self._missed: list[int] = []
        self._edges = np.zeros(1, dtype=int)

    def step_of(self, number: int) -> int:
        """Return the first step of a bin that was drawn."""
        return int(self._edges[min(number, len(self._edges) - 1)])

    def draw(self, stage: Stage, view: View, history: FrameHistory) -> str:
        """Return the strip as SVG, with a mark at the shown step, and its loop."""
        theme, step = view.theme, history.at(view.step).step
        events = list(history.log)
        self._follow(history)
        bins = binned(np.array(self._steps), np.array(self._rmse), np.array(self._missed))
        self._edges = bins.edges
        span = bins.edges[-1] - bins.edges[0]
        place = LEFT + (WIDTH - LEFT - RIGHT) * (bins.edges - bins.edges[0]) / span
        shown = np.interp(step + 0.5, bins.edges, place)
        ink, quiet, name = css(theme.text), css(theme.quiet), stage.error_name
        return readable(
            f'<svg data-testid="run" data-marks="steps of the run" '
            f'viewBox="0 0 {WIDTH:g} {_HEIGHT:g}" width="100%" '
            f'style="display:block;cursor:pointer"><style>.bin:hover{{fill:{ink};'
            f"fill-opacity:.25}}</style>"
            f'<text x="6" y="{_TOP + 14:g}" font-size="10.5" fill="{quiet}">{name}</text>'
            f'<text x="6" y="{_HEIGHT - 4:g}" font-size="10.5" fill="{quiet}">missed</text>'
            f"{_loop(theme, place, bins.edges, view.loop)}{_heat(theme, place, bins.missed)}"
            f"{_line(theme, place, bins.rmse)}"
            f"{_flags(theme, place, bins.edges, events)}"
            f'<path data-testid="run-cursor" d="M{shown:.1f} 0V{_HEIGHT:g}" stroke="{ink}" '
            f'stroke-width="2"/><path data-testid="run-pointer" d="M0 0V{_HEIGHT:g}" '
            f'visibility="hidden" stroke="{ink}" stroke-dasharray="3 2"/>'
            f"{_targets(stage, place, bins, events)}</svg>"
        )

    def _follow(self, history: FrameHistory) -> None:
        """Take the frames that have come, and drop those that the history has dropped."""
        seen = self._steps[-1] if self._steps else -1
        for frame in history.until(history.last_step, history.last_step - seen):
            if frame.step > seen:
                self._steps.append(frame.step)
                self._rmse.append(frame.scores.rmse)
                self._missed.append(sum(len(cycle.missed) for cycle in frame.cycles))
        dropped = int(np.searchsorted(self._steps, history.first_step))
        for values in (self._steps, self._rmse, self._missed):
            del values[:dropped]


def binned(steps: np.ndarray, rmse: np.ndarray, missed: np.ndarray) -> RunBins:
    """Return steps (T,) with their RMSE and missed frames in at most `MOST_BINS` even bins."""
    first, count = int(steps[0]), int(steps[-1] - steps[0]) + 1
    bins = min(MOST_BINS, count)
    # The first step of each bin, rounded up: no bin is empty of step numbers.
    edges = first - (-np.arange(bins + 1) * count // bins)
    where = np.searchsorted(edges, steps, side="right") - 1
    known = np.isfinite(rmse)
    squares = np.bincount(where[known], rmse[known] ** 2, bins)
    told = np.bincount(where[known], minlength=bins)
    mean = np.sqrt(np.divide(squares, told, out=np.full(bins, np.nan), where=told > 0))
    return RunBins(edges, mean, np.bincount(where, missed, bins))


def _line(theme: Theme, place: np.ndarray, rmse: np.ndarray) -> str:
    known = rmse > 0
    if not known.any():
        return ""
    height = np.log10(rmse[known])
    high, low = height.max(), min(height.min(), height.max() - 1.0)
    middle = (place[:-1] + place[1:])[known] / 2
    y = _TOP + (high - height) / (high - low) * (_BOTTOM - _TOP)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(middle, y, strict=True))
    return (
        f'<polyline points="{points}" fill="none" stroke="{css(theme.seeing)}" stroke-width="1.6"/>'
    )


def _loop(theme: Theme, place: np.ndarray, edges: np.ndarray, loop: tuple[int, int] | None) -> str:
    """Return a ground under the steps of a loop."""
    if loop is None:
        return ""
    begin, end = np.interp([loop[0], loop[1] + 1], edges, place)
    return (
        f'<rect data-testid="loop" x="{begin:.1f}" y="1" width="{end - begin:.1f}" '
        f'height="{_HEIGHT - 2:g}" fill="{css(theme.fused)}" fill-opacity=".22" '
        f'stroke="{css(theme.fused)}"/>'
    )


def _heat(theme: Theme, place: np.ndarray, missed: np.ndarray) -> str:
    """Return a box per bin in which frames were missed, the darker the more."""
    most = max(missed.max(), 1.0)
    return "".join(
        f'<rect class="heat" x="{place[i]:.1f}" y="{_HEIGHT - _HEAT - 2:g}" height="{_HEAT:g}" '
        f'width="{place[i + 1] - place[i]:.1f}" '
        f'fill="{css(mixed(theme.down, theme.panel, 0.25 + 0.75 * float(missed[i] / most)))}"/>'
        for i in np.flatnonzero(missed)
    )


def _flags(theme: Theme, place: np.ndarray, edges: np.ndarray, events: Sequence[LogEntry]) -> str:
    """Return a flag at each step with an event; trouble has the colour of a node that is down."""
    trouble: dict[int, bool] = {}
    for event in events:
        if edges[0] <= event.step < edges[-1]:
            trouble[event.step] = event.trouble or trouble.get(event.step, False)
    parts = []
    for step, is_trouble in sorted(trouble.items()):
        x = np.interp(step, edges, place)
        colour = css(theme.down if is_trouble else theme.fused)
        parts.append(
            f'<path class="flag" d="M{x:.1f} {_BOTTOM:g}V1l8 3.5l-8 3.5" fill="{colour}" '
            f'stroke="{colour}"/>'
        )
    return "".join(parts)


def _targets(stage: Stage, place: np.ndarray, bins: RunBins, events: Sequence[LogEntry]) -> str:
    """Return what the pointer meets: a box per bin, with its values in words."""
    unit, seconds = stage.score.unit.removeprefix("1"), stage.setup.time_step_s
    name = stage.error_name
    words: dict[int, list[str]] = {}
    for event in events:
        number = int(np.searchsorted(bins.edges, event.step, side="right")) - 1
        words.setdefault(number, []).append(f"{event.step}: {event.text}")
    parts = []
    for i in range(len(bins.rmse)):
        first, last = int(bins.edges[i]), int(bins.edges[i + 1]) - 1
        steps = f"step {first}" if first == last else f"steps {first} to {last}"
        known = np.isfinite(bins.rmse[i])
        rmse = f"{name} {rounded(bins.rmse[i])} {unit}".strip() if known else f"no {name}"
        told = [steps, rmse, f"{bins.missed[i]:.0f} senders missed", *words.get(i, ())[:6]]
        parts.append(
            f'<rect class="bin" data-node="{i}" data-time="{first * seconds:g}" '
            f'x="{place[i]:.1f}" y="0" height="{_HEIGHT:g}" '
            f'width="{place[i + 1] - place[i]:.1f}" fill="#000" fill-opacity="0">'
            f"<title>{escape(chr(10).join(told))}</title></rect>"
        )
    return "".join(parts)
