"""The zoomed picture: where every node believes the truth to be, as ellipses in two states."""

from html import escape

import numpy as np

from dashboard.frame import Array, Frame
from dashboard.geometry import ellipse_axes
from dashboard.stage import Stage
from dashboard.theme import Colour, Theme, css
from dashboard.view import MANY_NODES

SIZE, MARGIN = 300.0, 14.0
_MOST_NODES = 120


def zoom(
    stage: Stage, theme: Theme, frame: Frame, pair: tuple[int, int], selected: int | None
) -> str:
    """An SVG of two states around the truth, or around what all believe where it is not known."""
    states = list(pair)
    mean, cov = frame.belief.mean[:, states], frame.belief.cov[:, states][:, :, states]
    fused = frame.fused.mean[states]
    centre = frame.truth[states]
    known = bool(np.isfinite(centre).all())
    if not known:
        centre = fused
    shown = np.isfinite(mean).all(-1) & np.isfinite(cov).all((-1, -2))
    body = ""
    if np.isfinite(centre).all() and shown.any():
        nodes = np.flatnonzero(shown)
        if len(nodes) > _MOST_NODES:
            nodes = nodes[:: -(-len(nodes) // _MOST_NODES)]
        spans = _spans(stage, mean[nodes] - centre, cov[nodes])
        body = _Drawing(stage, theme, frame, states, centre, spans, known).picture(nodes, selected)
    unit = [escape(stage.state_units[i]) for i in states]
    name = [escape(stage.state_names[i]) for i in states]
    sigma = "set" if stage.certain else f"{stage.deviations:g}σ"
    legend = [(theme.truth, "truth"), (theme.fused, "fused"), (theme.estimate, "nodes")]
    if selected is not None:
        legend.append((theme.selection, escape(stage.names[selected])))
    spans_html = "".join(
        f'<span style="margin-right:9px;white-space:nowrap"><span style="color:{css(c)}">●</span> '
        f"{text}</span>"
        for c, text in legend
    )
    return (
        f'<div style="font-size:11px;color:{css(theme.text)}"><svg data-testid="zoom" '
        f'viewBox="0 0 {SIZE:g} {SIZE:g}" width="100%" style="display:block">{body}</svg>'
        f'<div style="padding:2px 4px">{spans_html} {sigma}</div>'
        f'<div style="padding:0 4px 2px;color:{css(theme.quiet)}">{name[0]} [{unit[0]}] →, '
        f"{name[1]} [{unit[1]}] ↑</div></div>"
    )


def _spans(stage: Stage, off: Array, cov: Array) -> Array:
    """Half-widths (2,) of what is shown: most of the ellipses, whole, with some air."""
    reach = np.abs(off) + stage.deviations * np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    span = 1.12 * np.quantile(reach, 0.9, axis=0)
    if stage.state_units and len(set(stage.place)) == 2:
        span = np.full(2, span.max())
    return np.maximum(span, 1e-12)


class _Drawing:
    """The ellipses of one frame, in pixels."""

    def __init__(
        self, stage: Stage, theme: Theme, frame: Frame, states: list[int], centre: Array,
        spans: Array, known: bool,
    ) -> None:  # fmt: skip
        self._stage, self._theme, self._frame, self._states = stage, theme, frame, states
        self._centre, self._scale, self._known = centre, (SIZE / 2 - MARGIN) / spans, known
        self._spans = spans

    def picture(self, nodes: np.ndarray, selected: int | None) -> str:
        theme, frame, states = self._theme, self._frame, self._states
        mean, cov = frame.belief.mean[:, states], frame.belief.cov[:, states][:, :, states]
        faint = 0.35 if len(nodes) > MANY_NODES else 0.7
        parts = [self._rings()]
        others = [node for node in nodes if node != selected]
        parts += [self._ellipse(mean[i], cov[i], theme.estimate, faint, 1.0) for i in others]
        fused, fused_cov = frame.fused.mean[states], frame.fused.cov[states][:, states]
        if np.isfinite(fused).all():
            parts.append(self._ellipse(fused, fused_cov, theme.fused, 1.0, 2.0, fill=0.22))
        parts += [self._dot(mean[i], theme.estimate, 2.4, int(i)) for i in others]
        if selected is not None and np.isfinite(mean[selected]).all():
            parts.append(self._ellipse(mean[selected], cov[selected], theme.selection, 1.0, 2.0))
            parts.append(self._dot(mean[selected], theme.selection, 3.5, selected))
        if self._known:
            x, y = self._pixel(self._centre)
            parts.append(
                f'<path d="M{x - 7:.1f} {y:.1f}h14M{x:.1f} {y - 7:.1f}v14" '
                f'stroke="{css(theme.truth)}" stroke-width="2.5"/>'
            )
        return "".join(parts)

    def _pixel(self, point: Array) -> tuple[float, float]:
        x, y = (point - self._centre) * self._scale
        return SIZE / 2 + float(x), SIZE / 2 - float(y)

    def _rings(self) -> str:
        """Circles of round radius, or a cross of axes where the two states differ in kind."""
        theme, middle = self._theme, SIZE / 2
        step = _round_number(float(self._spans[0]) / 3)
        if len(set(self._stage.place)) == 2:
            count = int(self._spans[0] / step)
            unit = escape(self._stage.state_units[self._states[0]])
            return "".join(
                f'<circle cx="{middle:g}" cy="{middle:g}" r="{k * step * self._scale[0]:.1f}" '
                f'fill="none" stroke="{css(theme.faint)}"/><text x="{middle + 3:g}" '
                f'y="{middle - k * step * self._scale[0] + 11:.1f}" font-size="10" '
                f'fill="{css(theme.quiet)}">{k * step:.3g} {unit}</text>'
                for k in range(1, count + 1)
            )
        lines = (
            f'<path d="M0 {middle:g}H{SIZE:g}M{middle:g} 0V{SIZE:g}" stroke="{css(theme.faint)}"/>'
        )
        ends = [(SIZE - 46, middle - 4, self._spans[0]), (middle + 4, 12.0, self._spans[1])]
        return lines + "".join(
            f'<text x="{x:g}" y="{y:g}" font-size="10" fill="{css(theme.quiet)}">±{span:.2g}</text>'
            for x, y, span in ends
        )

    def _ellipse(
        self, mean: Array, cov: Array, colour: Colour, opacity: float, width: float, fill: float = 0
    ) -> str:
        scaled = self._scale[:, None] * cov * self._scale
        half, angle = ellipse_axes(scaled[None])
        x, y = self._pixel(mean)
        a, b = self._stage.deviations * half[0]
        inside = css(colour, fill) if fill else "none"
        # Up is down in SVG: the angle turns round.
        return (
            f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{a:.1f}" ry="{b:.1f}" fill="{inside}" '
            f'transform="rotate({-np.degrees(angle[0]):.1f} {x:.1f} {y:.1f})" '
            f'stroke="{css(colour, opacity)}" stroke-width="{width:g}"/>'
        )

    def _dot(self, point: Array, colour: Colour, radius: float, node: int) -> str:
        x, y = self._pixel(point)
        return (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{css(colour)}" '
            f'data-node="{node}" style="cursor:pointer"><title>node '
            f"{escape(self._stage.names[node])}</title></circle>"
        )


def _round_number(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
