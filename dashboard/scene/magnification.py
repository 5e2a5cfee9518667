"""How much larger than the map errors and ellipses are drawn, so that they can be seen."""

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import SCENE_WIDTH

MAGNIFIED = (1, 2, 5, 10, 20, 50, 100)
# Belief and error of the middle node take so much of the map; the factor changes when they take
# less or more than these parts of it.
_WANTED, _LEAST, _MOST = SCENE_WIDTH / 7, 0.3, 1.3


def followed_magnification(now: float, frame: StepFrame, scale: float) -> float:
    """Return the factor for a frame, where it is `now`; a scene has `scale` units per metre.

    The median over the nodes decides, so that a few nodes that diverge leave the picture alone.
    """
    scores = frame.scores
    reach = np.fmax(frame.stage.deviations * scores.width, scores.error)
    known = reach[frame.alive & np.isfinite(reach)]
    if not len(known):
        return now
    drawn = max(float(np.median(known)) * scale, 1e-9)
    if _LEAST * _WANTED <= now * drawn <= _MOST * _WANTED:
        return now
    return float(max((m for m in MAGNIFIED if m * drawn <= _WANTED), default=1))
