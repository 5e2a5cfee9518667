"""The rule `labelled` at a node that checks itself, and asks for help when it is lost.

A node whose records do not fit its belief says so in its shares and sends no checkpoint. Neighbours
that are not lost themselves owe it a checkpoint, and send again what it does not report to hold.
The node puts the first checkpoint that comes in the place of its base.
"""

from dataclasses import dataclass

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.rules.labelled.flooding import LabelledContent, LabelledFlooding
from concord.nodes.rules.labelled.frame import LabelledShare
from concord.nodes.rules.labelled.self_check import ASKING, is_suspect, trusting
from concord.nodes.rules.labelled.window_filter import one_lane
from concord.nodes.rules.labelled.window_smoother import smoothed_past


@dataclass(frozen=True)
class SelfCheckedFlooding(LabelledFlooding):
    """`LabelledFlooding` with the check of a node's own belief."""

    def is_suspect(self, content: LabelledContent) -> bool:
        """Whether the records of the window do not fit the belief."""
        return bool(is_suspect(content.windows)[0, 0])

    def bid(self, content: LabelledContent) -> int | None:
        """The bid of `LabelledFlooding`; a node that asks for help has urgent news once a step."""
        return super().bid(content._replace(needs=content.needs or _asks(content)))

    def compose(self, content: LabelledContent) -> tuple[LabelledContent, bytes]:
        """The share of `LabelledFlooding`; no checkpoint while the node asks for help."""
        if not _asks(content):
            return super().compose(content)
        after, body = super().compose(content._replace(owed=False))
        share = self.frames.decode(body)._replace(suspect=True)
        return after._replace(owed=content.owed), self.frames.encode(share)

    def _hear(self, content: LabelledContent, place: int, share: LabelledShare) -> LabelledContent:
        """Note a neighbour's statements about itself; help a neighbour that asks."""
        heard = super()._hear(content, place, share)
        if not share.suspect or _asks(content):
            return heard
        # The digest is about the last steps. Of older ones the neighbour reports nothing.
        older = self.frames.window_steps - self.frames.digest_steps
        return heard._replace(near=heard.near.forgotten(place, last=older), owed=True)

    def _fuse_base(
        self, content: LabelledContent, checkpoint: Gaussian
    ) -> tuple[LabelledContent, str]:
        """Fuse a checkpoint with the base; it replaces the base of a node that asks for help."""
        if not _asks(content) or not self._has_common_base(content):
            return super()._fuse_base(content, checkpoint)
        windows = content.windows._replace(base=one_lane(checkpoint))
        windows = trusting(windows, np.ones((1, 1), dtype=bool))
        return content._replace(kept=content.kept._replace(windows=windows)), "adopted"


def _asks(content: LabelledContent) -> bool:
    return bool(is_suspect(content.windows, ASKING)[0, 0])


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
