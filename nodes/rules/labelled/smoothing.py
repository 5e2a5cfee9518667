"""The rule `labelled` at a node that also estimates the past from its window."""

from dataclasses import dataclass

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.rules.labelled.checked import SelfCheckedFlooding
from concord.nodes.rules.labelled.flooding import LabelledContent
from concord.nodes.rules.labelled.window_smoother import smoothed_past


@dataclass(frozen=True)
class SmoothingFlooding(SelfCheckedFlooding):
    """`SelfCheckedFlooding` with the smoothed states of the last `smooth_steps` steps."""

    smooth_steps: int = 0

    def smoothed(self, content: LabelledContent) -> Gaussian:
        """States of 0, 1, ... steps ago given all records: mean (L, n), cov (L, n, n).

        NaN while the node knows nothing, and before the window's first step.
        """
        mean, cov = smoothed_past(self.filter, content.windows, self.smooth_steps)
        past = Gaussian(mean[0, 0], cov[0, 0])
        return Gaussian(*(np.full_like(one, np.nan) for one in past)) if content.needs else past
