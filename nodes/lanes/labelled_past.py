"""`concord.nodes.rules.labelled.smoothing` at all nodes of all runs at once."""

from dataclasses import dataclass

from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.labelled import BatchedLabelledContent
from concord.nodes.lanes.labelled_check import BatchedSelfChecked
from concord.nodes.rules.labelled.window_smoother import smoothed_past


@dataclass(frozen=True)
class BatchedSmoothing(BatchedSelfChecked):
    """`BatchedSelfChecked` with the smoothed states of the last `smooth_steps` steps."""

    smooth_steps: int = 0

    def smoothed(self, content: BatchedLabelledContent) -> Gaussian:
        """States of 0, 1, ... steps ago given all records: mean (R, N, L, n), cov (R, N, L, n, n);
        NaN before the window's first step."""
        return smoothed_past(self.filter, content.windows, self.smooth_steps)
