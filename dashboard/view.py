"""Choices of the user: step, node and visible parts."""

from dataclasses import dataclass, field
from threading import RLock

from concord.dashboard.theme import DARK, Theme

ELLIPSES = ("selected", "all", "none")
ORDERS = ("number", "error", "age")

# Above these a picture with everything in it says nothing any more.
MANY_NODES, MOST_LABELS = 40, 60


@dataclass
class View:
    """The state of the page. The loop that draws changes it, under `lock`: others copy it.

    Attributes:
        step: the one that is shown; `follow` keeps it at the newest.
        playing: a recording runs on by itself, `speed` times as fast as the plant.
        cursor: place within the step, 0..rounds: whole part the cycle, rest the time within it.
        magnify: how much larger than the network errors and ellipses are drawn.
        pair: the two states of the zoomed picture; `state` that of the chart.
    """

    theme: Theme = DARK
    step: int = 0
    follow: bool = True
    playing: bool = True
    speed: float = 1.0
    cursor: float = 0.0
    selected: int | None = None
    hovered: int | None = None
    ellipses: str = "selected"
    magnify: float = 1.0
    sight_lines: bool = True
    sight_range: bool = True
    labels: bool = True
    order: str = "number"
    pair: tuple[int, int] = (0, 1)
    state: int = 0
    lock: RLock = field(default_factory=RLock, repr=False)

    def look_at(self, step: int) -> None:
        """Show this step from its beginning, and stay there."""
        self.follow, self.playing = False, False
        self.step, self.cursor = step, 0.0
