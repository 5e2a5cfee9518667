"""The counters that a network in arrays shows, where some of its nodes are absent."""

from typing import NamedTuple

import numpy as np

from concord.nodes.lanes.filter import Counters, added


class Tally(NamedTuple):
    """Totals (R, N) by name: those that are `shown`, and those of the rule as last `seen`.

    A rule counts on for nodes that are out; what is shown of them stays what it was.
    """

    shown: Counters
    seen: Counters

    def after(self, counters: Counters, frames: np.ndarray, present: np.ndarray) -> "Tally":
        """With a step more, in which nodes sent so many `frames` (R, N); `present` (N,) counted."""
        gained = {name: count - self.seen.get(name, 0) for name, count in counters.items()}
        gained["sent"] = frames
        gained = {name: np.where(present, count, 0) for name, count in gained.items()}
        return Tally(added(self.shown, gained), counters)

    def forgetting(self, nodes: np.ndarray) -> "Tally":
        """Nodes (J,) have come back, and count from nothing."""
        shown = {name: count.copy() for name, count in self.shown.items()}
        for count in shown.values():
            count[:, nodes] = 0
        return self._replace(shown=shown)


def masked(present: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (R, N, ...), NaN at nodes that are not `present` (N,)."""
    if present.all():
        return values
    return np.where(present.reshape(-1, *(1,) * (values.ndim - 2)), values, np.nan)
