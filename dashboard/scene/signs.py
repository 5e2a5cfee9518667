"""Colour and sign of a node in each condition, the same in scene, table and legend."""

from concord.dashboard.frames.conditions import BLIND, DOWN, REJECTED, SEEING, STALE
from concord.dashboard.theme import Colour, Theme

# A second sign beside the colour.
MARKS = {DOWN: "✕", REJECTED: "◆", STALE: "◐", BLIND: "○", SEEING: "●"}


def colour_of(theme: Theme, condition: str) -> Colour:
    """Return the colour of a node in that condition."""
    return {
        DOWN: theme.down,
        REJECTED: theme.estimate,
        STALE: theme.stale,
        BLIND: theme.blind,
        SEEING: theme.seeing,
    }[condition]
