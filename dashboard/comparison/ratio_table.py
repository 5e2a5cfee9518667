"""The table of two runs: their figures up to the shown step, and the ratios with intervals."""

from html import escape

import numpy as np

from concord.dashboard.comparison.other_run import OtherRun, PairedScores, RatioInterval, batched
from concord.dashboard.digits import rounded
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.theme import Theme, css

_ROWS = (
    ("RMSE", "rmse", True),
    ("disagreement", "spread", True),
    ("NEES", "nees", False),
    ("centralised", "central", True),
    ("bytes a step", "payload", False),
    ("missed a step", "missed", False),
)
"""Heading, score, and whether it is a root mean square."""
# Of all others, less is better.
_NEITHER = ("nees", "central")


def ratio_table(theme: Theme, other: OtherRun, history: FrameHistory, step: int) -> str:
    """Return the table up to a step as HTML."""
    paired, (first, second) = other.paired(history, step), map(escape, other.labels)
    quiet = css(theme.quiet)
    if not len(paired.steps):
        told = (
            f"no scored step of both runs yet; steps count from {other.stage.score.first_step} on"
        )
        return f'<div data-testid="ratios" style="padding:4px 10px;color:{quiet}">{told}</div>'
    rows = "".join(_row(theme, paired, other, *row) for row in _ROWS)
    return (
        '<div data-testid="ratios" style="font-size:12px;padding:4px 10px;color:'
        f'{css(theme.text)}">'
        '<table style="width:100%;text-align:right;font-variant-numeric:tabular-nums">'
        f'<tr style="color:{quiet}"><th></th><th>{first}</th><th style="color:'
        f'{css(theme.sending)}">{second}</th><th title="{second} over {first}">ratio</th>'
        f'<th title="95 % interval from the means of ten batches of steps">95 %</th></tr>{rows}'
        f'</table><div style="color:{quiet};font-size:11px">steps {paired.steps[0]} to '
        f"{paired.steps[-1]}; a ratio above 1: {second} has more; dashed in the scene: {second}"
        "</div></div>"
    )


def _row(
    theme: Theme, paired: PairedScores, other: OtherRun, heading: str, score: str, is_root: bool
) -> str:
    power = 2 if is_root else 1
    powers = [values[score] ** power for values in (paired.first, paired.second)]
    known = np.isfinite(powers[0]) & np.isfinite(powers[1])
    if not known.any():
        return ""
    mine, theirs = (values[known] for values in powers)
    shown = [float(values.mean() ** (1 / power)) for values in (mine, theirs)]
    ratio, low, high = ratio_of(mine, theirs, is_root, other.ratio)
    # An interval that holds 1 decides nothing.
    decided = low > 1 or high < 1
    colour = theme.text if score in _NEITHER else theme.down if ratio > 1 else theme.fused
    style = f"font-weight:600;color:{css(colour)}"
    interval = f"{low:.2g} to {high:.2g}" if np.isfinite(low) else "-"
    return (
        f'<tr data-score="{score}"><td style="text-align:left">{heading}</td>'
        f"<td>{rounded(shown[0], 4)}</td><td>{rounded(shown[1], 4)}</td>"
        f'<td style="{style if decided else ""}">{"-" if np.isnan(ratio) else f"{ratio:.3g}"}</td>'
        f"<td>{interval}</td></tr>"
    )


def ratio_of(
    first: np.ndarray, second: np.ndarray, is_root: bool, interval: RatioInterval
) -> tuple[float, float, float]:
    """Return the ratio of the means of (T,) values of two runs, the second over the first, of their
    roots if `is_root`, with its interval."""
    nan = float("nan")
    if not first.any():
        return nan, nan, nan
    power = 1 if is_root else 2
    value = float((second.mean() / first.mean()) ** 0.5) ** power
    groups = batched(second), batched(first)
    if not len(groups[0]) or (groups[0] == groups[1]).all():
        return value, nan, nan
    _, low, high = interval(*groups)
    return value, low**power, high**power
