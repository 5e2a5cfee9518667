"""Choices of the user: step, node and visible parts."""

from dataclasses import dataclass, field
from threading import RLock

from concord.dashboard.theme import DARK, Theme

ELLIPSES = ("selected", "all", "none")
WINDOWS_S = {"all": 0.0, "last 30 s": 30.0, "last 120 s": 120.0}
ORDERS = ("number", "error", "age")

# Above these a picture with everything in it says nothing any more.
MANY_NODES, MOST_LABELS = 40, 60


@dataclass
class View:
    """The state of the page. The loop that draws changes it, under `lock`: others copy it.

    Attributes:
        step: the one that is shown; `follow` keeps it at the newest.
        playing: a recording runs on by itself, `speed` times as fast as the plant.
        loop: the first and the last step between which a recording plays again and again.
        cursor: place within the step, 0..rounds: whole part the cycle, rest the time within it.
        magnify: how much larger than the network errors and ellipses are drawn; `is_automatic`
            lets it follow the errors.
        follow_target: the cameras move with the target.
        window_s: how much of the time before the shown step the charts have; 0 is all.
        pair: the two states of the zoomed picture; `state` that of the chart.
    """

    theme: Theme = DARK
    step: int = 0
    follow: bool = True
    playing: bool = True
    speed: float = 1.0
    loop: tuple[int, int] | None = None
    cursor: float = 0.0
    selected: int | None = None
    hovered: int | None = None
    ellipses: str = "selected"
    magnify: float = 1.0
    is_automatic: bool = True
    follow_target: bool = False
    sight_lines: bool = True
    sight_range: bool = True
    labels: bool = True
    order: str = "number"
    window_s: float = 0.0
    pair: tuple[int, int] = (0, 1)
    state: int = 0
    lock: RLock = field(default_factory=RLock, repr=False)

    def go_to_end(self) -> None:
        """Show the newest step, and what comes."""
        self.follow, self.playing = True, False

    def play(self, first_step: int, last_step: int) -> None:
        """Play on; from the beginning where the last step is shown."""
        if self.step >= last_step and self.loop is None:
            self.step, self.cursor = first_step, 0.0
        self.follow, self.playing = False, True

    def look_at(self, step: int) -> None:
        """Show this step from its beginning, and stay there."""
        self.follow, self.playing = False, False
        self.step, self.cursor = step, 0.0

    def loop_here(self, is_first: bool, first_step: int, last_step: int) -> None:
        """Begin or end the loop at the shown step; its other end stays, or is that of the run."""
        low, high = self.loop or (first_step, last_step)
        if is_first:
            self.loop = self.step, high if high > self.step else last_step
        else:
            self.loop = low if low < self.step else first_step, self.step
