"""The zonotope filter: the Kalman filter's gain, with sets in place of covariances.

Source: Combastel (2015), Zonotopes and Kalman observers: gain optimality under distinct uncertainty
paradigms and robust convergence, Automatica 55, with strips as further readings (Le et al. (2013)).
"""

import numpy as np

from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.cycle import flat
from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    magnitudes,
    taken,
)
from concord.features.sets.filters.rounding import rounding_bound, row_units
from concord.features.sets.filters.zonotope import Zonotope, half_widths, reduced
from concord.filters.linalg import join_columns, join_entries, join_rows, multiply

GENERATORS = 30


def zonotope_step(
    before: Zonotope,
    evidence: StepReadings,
    generators: int = GENERATORS,
    criterion: Criterion = unit_free,
) -> Zonotope:
    """The zonotope (..., k) of what becomes of a state in `before` (..., n), given the evidence.

    Any gain keeps the state inside; the one taken makes the squared length of all generators least,
    in any weights of the states. NaN in lanes in which a reading lies beside all that the zonotope
    and the bounds allow.

    Args:
        generators: how many to keep, k at least.
        criterion: the weights by which generators are compared when they are too many.
    """
    motion = evidence.motion
    lost = np.isnan(before.centre).any(-1)
    if lost.any():
        before = Zonotope(*(np.nan_to_num(part) for part in before))
    image = _columns(motion, before)
    reach = np.abs(before.centre) + half_widths(before)
    readings = taken(evidence.exact), taken(evidence.bounded)
    seen = join_rows(*(_columns(part, before) for part in readings))
    offset = join_entries(*(part.values - multiply(part.state, before.centre) for part in readings))
    size = join_entries(*(magnitudes(part, reach) + np.abs(part.values) for part in readings))
    rounding = rounding_bound(image.shape[-1] + before.centre.shape[-1])
    width = join_entries(*(part.half_widths for part in readings)) + rounding * size
    spread = width[..., None] * np.eye(width.shape[-1])
    gain = _best_gain(image, seen, spread)
    centre = multiply(motion.state, before.centre) + multiply(gain, offset)
    moved = magnitudes(motion, reach) + multiply(np.abs(gain), size)
    margin = (rounding * moved)[..., None] * np.eye(moved.shape[-1])
    after = join_columns(image - gain @ seen, gain @ spread, margin)
    kept = reduced(Zonotope(centre, after), generators, criterion)
    beside = np.abs(offset) > (np.abs(seen).sum(-1) + width) * (1.0 + rounding)
    contradicted = np.asarray(lost | beside.any(-1))[..., None]
    return Zonotope(
        np.where(contradicted, np.nan, kept.centre),
        np.where(contradicted[..., None], np.nan, kept.generators),
    )


def _best_gain(image: np.ndarray, seen: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The gain (..., k, m) of the Kalman filter; each reading in units of its own."""
    units = row_units(join_columns(seen, spread))[..., None]
    seen, spread = seen / units, spread / units
    innovation = seen @ seen.mT + spread @ spread.mT
    gain: np.ndarray = image @ seen.mT @ np.linalg.pinv(innovation, hermitian=True) / units.mT
    return gain


def _columns(rows: BoundedMotion | Readings, before: Zonotope) -> np.ndarray:
    """The map (..., rows, q + g q') of the generators' coefficients and the noise."""
    return join_columns(rows.state @ before.generators, flat(rows.noise))
