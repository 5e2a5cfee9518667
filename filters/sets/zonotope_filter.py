"""The zonotope filter: the Kalman filter's gain, with sets in place of covariances.

Source: Combastel (2015), Zonotopes and Kalman observers: gain optimality under distinct uncertainty
paradigms and robust convergence, Automatica 55, with strips as further readings (Le et al. (2013)).
"""

import numpy as np

from concord.filters.lanes import join_columns, join_entries, join_rows
from concord.filters.linalg import multiply
from concord.filters.sets.cycle import flat
from concord.filters.sets.ellipsoid import rounding_bound
from concord.filters.sets.evidence import BoundedMotion, Readings, StepReadings, magnitudes, taken
from concord.filters.sets.zonotope import Zonotope, half_widths, reduced

GENERATORS = 30


def zonotope_step(
    before: Zonotope, evidence: StepReadings, generators: int = GENERATORS
) -> Zonotope:
    """The zonotope (..., k) of what becomes of a state in `before` (..., n), given the evidence.

    Any gain keeps the state inside; the one taken makes the squared length of all generators least.

    Args:
        generators: how many to keep, k at least.
    """
    motion = evidence.motion
    image = _columns(motion, before)
    reach = np.abs(before.centre) + half_widths(before)
    readings = taken(evidence.exact), taken(evidence.bounded)
    seen = join_rows(*(_columns(part, before) for part in readings))
    offset = join_entries(*(part.values - multiply(part.state, before.centre) for part in readings))
    size = join_entries(
        *(magnitudes(part.state, part.noise, reach) + np.abs(part.values) for part in readings)
    )
    rounding = rounding_bound(image.shape[-1] + before.centre.shape[-1])
    width = join_entries(*(part.half_widths for part in readings)) + rounding * size
    spread = width[..., None] * np.eye(width.shape[-1])
    innovation = seen @ seen.mT + spread**2
    gain = image @ seen.mT @ np.linalg.pinv(innovation, hermitian=True)
    centre = multiply(motion.state, before.centre) + multiply(gain, offset)
    moved = magnitudes(motion.state, motion.noise, reach) + multiply(np.abs(gain), size)
    margin = (rounding * moved)[..., None] * np.eye(moved.shape[-1])
    after = join_columns(image - gain @ seen, gain @ spread, margin)
    return reduced(Zonotope(centre, after), generators)


def _columns(rows: BoundedMotion | Readings, before: Zonotope) -> np.ndarray:
    """The map (..., rows, q + g q') of the generators' coefficients and the noise."""
    return join_columns(rows.state @ before.generators, flat(rows.noise))
