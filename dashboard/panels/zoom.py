"""The zoomed picture: where every node believes the truth to be, as ellipses in two states."""

from html import escape

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.scene.geometry import ellipse_axes, zonotope_corners
from concord.dashboard.theme import Colour, Theme, css
from concord.dashboard.view import MANY_NODES

SIZE, MARGIN = 300.0, 14.0
_MOST_NODES = 120


def zoom(
    stage: Stage, theme: Theme, frame: StepFrame, pair: tuple[int, int], selected: int | None
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
    sigma = "set" if stage.set_valued else f"{stage.deviations:g}σ"
    legend = [(theme.truth, "truth"), (theme.fused, stage.fused_name), (theme.estimate, "nodes")]
    if selected is not None:
        legend.append((theme.selection, escape(stage.names[selected])))
    spans_html = "".join(
        f'<span style="margin-right:9px;white-space:nowrap"><span style="color:{css(c)}">●</span> '
        f"{text}</span>"
        for c, text in legend
    )
    return (
        f'<div style="font-size:11px;padding-right:8px;color:{css(theme.text)}">'
        '<svg data-testid="zoom" '
        f'viewBox="0 0 {SIZE:g} {SIZE:g}" width="100%" style="display:block">{body}</svg>'
        f'<div style="padding:2px 4px">{spans_html}</div>'
        f'<div style="padding:0 4px 2px;color:{css(theme.quiet)}">{name[0]} [{unit[0]}] →, '
        f"{name[1]} [{unit[1]}] ↑, {sigma}</div></div>"
    )


def _spans(stage: Stage, off: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Half-widths (2,) of what is shown: most of the ellipses, whole, with some air."""
    reach = np.abs(off) + stage.deviations * np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    span = 1.12 * np.quantile(reach, 0.9, axis=0)
    if stage.state_units and len(set(stage.place)) == 2:
        span = np.full(2, span.max())
    return np.maximum(span, 1e-12)


class _Drawing:
    """The ellipses of one frame, in pixels."""

    def __init__(
        self, stage: Stage, theme: Theme, frame: StepFrame, states: list[int], centre: np.ndarray,
        spans: np.ndarray, known: bool,
    ) -> None:  # fmt: skip
        self._stage, self._theme, self._frame, self._states = stage, theme, frame, states
        self._centre, self._scale, self._known = centre, (SIZE / 2 - MARGIN) / spans, known
        self._spans = spans

    def picture(self, nodes: np.ndarray, selected: int | None) -> str:
        theme, frame, states = self._theme, self._frame, self._states
        mean, cov = frame.belief.mean[:, states], frame.belief.cov[:, states][:, :, states]
        faint = 0.35 if len(nodes) > MANY_NODES else 0.7
        parts = [self._rings()]
        others = nodes[nodes != selected]
        parts.append(self._sets(others, mean, cov, theme.estimate, faint, 1.0))
        fused, fused_cov = frame.fused.mean[states], frame.fused.cov[states][:, states]
        if np.isfinite(fused).all():
            parts.append(self._ellipses(fused[None], fused_cov[None], theme.fused, 1.0, 2.0, 0.22))
        parts.append(self._dots(others, mean, theme.estimate, 2.4))
        if selected is not None and np.isfinite(mean[selected]).all():
            chosen = np.array([selected])
            parts.append(self._sets(chosen, mean, cov, theme.selection, 1.0, 2.0))
            parts.append(self._dots(chosen, mean, theme.selection, 3.5))
        if self._known:
            x, y = SIZE / 2, SIZE / 2
            parts.append(
                f'<path d="M{x - 7:.1f} {y:.1f}h14M{x:.1f} {y - 7:.1f}v14" '
                f'stroke="{css(theme.truth)}" stroke-width="2.5"/>'
            )
        # The text lies above all other marks, so that it stays readable.
        parts.append(self._scale_marks())
        return "".join(parts)

    def _pixels(self, points: np.ndarray) -> list[list[float]]:
        """Return the places of points (P, 2) in the drawing."""
        offsets = (points - self._centre) * self._scale
        return (SIZE / 2 + offsets * [1.0, -1.0]).tolist()

    def _rings(self) -> str:
        """Circles of round radius, or a cross of axes where the two states differ in kind."""
        middle, faint = SIZE / 2, css(self._theme.faint)
        if not self._is_map:
            return f'<path d="M0 {middle:g}H{SIZE:g}M{middle:g} 0V{SIZE:g}" stroke="{faint}"/>'
        return "".join(
            f'<circle cx="{middle:g}" cy="{middle:g}" r="{radius * self._scale[0]:.1f}" '
            f'fill="none" stroke="{faint}"/>'
            for radius in self._radii()
        )

    @property
    def _is_map(self) -> bool:
        return len(set(self._stage.place)) == 2

    def _radii(self) -> list[float]:
        """Of the circles: a few round numbers."""
        span = float(self._spans[0])
        step = _round_number(span / 2)
        return [k * step for k in range(1, int(span / step) + 1)]

    def _scale_marks(self) -> str:
        """Return the labels of the circles or of the ends of the axes."""
        middle = SIZE / 2
        if self._is_map:
            unit = escape(self._stage.state_units[self._states[0]])
            return "".join(
                self._mark(middle + 3, middle - r * self._scale[0] + 11, f"{rounded(r)} {unit}")
                for r in self._radii()
            )
        across, up = (f"±{span:.2g}" for span in self._spans)
        return self._mark(SIZE - 46, middle - 4, across) + self._mark(middle + 4, 12.0, up)

    def _mark(self, x: float, y: float, text: str) -> str:
        theme = self._theme
        return (
            f'<text x="{x:g}" y="{y:.1f}" font-size="11" fill="{css(theme.text)}" '
            f'stroke="{css(theme.panel)}" stroke-width="3" paint-order="stroke" '
            f'pointer-events="none">{text}</text>'
        )

    def _sets(
        self,
        nodes: np.ndarray,
        mean: np.ndarray,
        cov: np.ndarray,
        colour: Colour,
        opacity: float,
        width: float,
    ) -> str:
        """Return the beliefs of nodes: the zonotopes of those that keep one, ellipses of others."""
        kept = [node for node in nodes if self._frame.zonotopes[node] is not None]
        if not kept:
            return self._ellipses(mean[nodes], cov[nodes], colour, opacity, width)
        polygons = "".join(
            f'<polygon points="{self._corners(node, mean[node])}" fill="none" '
            f'stroke="{css(colour, opacity)}" stroke-width="{width:g}" stroke-linejoin="round"/>'
            for node in kept
        )
        others = np.setdiff1d(nodes, kept)
        return polygons + self._ellipses(mean[others], cov[others], colour, opacity, width)

    def _corners(self, node: int, mean: np.ndarray) -> str:
        generators = self._frame.zonotopes[node]
        assert generators is not None, "the node keeps a zonotope"
        corners = zonotope_corners(mean, generators[self._states])
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in self._pixels(corners))

    def _ellipses(
        self,
        mean: np.ndarray,
        cov: np.ndarray,
        colour: Colour,
        opacity: float,
        width: float,
        fill: float = 0,
    ) -> str:
        """Return the ellipses of means (M, 2) with covariances (M, 2, 2)."""
        half, angle = ellipse_axes(self._scale[:, None] * cov * self._scale)
        axes = (self._stage.deviations * half).tolist()
        # Up is down in SVG: the angle turns round.
        turns = (-np.degrees(angle)).tolist()
        inside = css(colour, fill) if fill else "none"
        ellipses = "".join(
            f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{a:.1f}" ry="{b:.1f}" '
            f'transform="rotate({turn:.1f} {x:.1f} {y:.1f})"/>'
            for (x, y), (a, b), turn in zip(self._pixels(mean), axes, turns, strict=True)
        )
        return (
            f'<g fill="{inside}" stroke="{css(colour, opacity)}" stroke-width="{width:g}">'
            f"{ellipses}</g>"
        )

    def _dots(self, nodes: np.ndarray, mean: np.ndarray, colour: Colour, radius: float) -> str:
        names = self._stage.names
        dots = "".join(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" data-node="{node}">'
            f"<title>node {escape(names[node])}</title></circle>"
            for node, (x, y) in zip(nodes.tolist(), self._pixels(mean[nodes]), strict=True)
        )
        return f'<g fill="{css(colour)}" style="cursor:pointer">{dots}</g>'


def _round_number(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
