"""Constrained zonotopes: sections of zonotopes, so that a strip cuts them exactly.

{c + G xi : |xi_i| <= 1, A xi = b} is kept as the zonotope `lifted` of (x, A xi - b), of which the
points with zeros at the end count. A reading is one more row, and nothing is lost. The number of
rows and of generators grows. The gain of the zonotope filter cuts the generators before
they are reduced, so a row can go, and the set is hardly ever larger than that filter's.

Source: Scott, Raimondo, Marseglia, Barton (2016), Constrained zonotopes: a new tool for set-based
estimation and fault detection, Automatica 69. The bounds of a set are proved by the multipliers of
a linear programme, so they hold whatever the accuracy of its solver. Sets have no lanes. Needs
scipy, and only when called.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from concord.features.sets.filters.cycle import flat
from concord.features.sets.filters.evidence import StepReadings, magnitudes, taken
from concord.features.sets.filters.rounding import pseudo_inverse, rounding_bound, row_units
from concord.features.sets.filters.zonotope import Zonotope, grown, half_widths, reduced
from concord.features.sets.filters.zonotope_filter import GENERATORS
from concord.filters.lanes import join_columns, join_entries, join_rows

CONSTRAINTS = 10
_PASSES = 3
_AT_END = 1e-7


@dataclass(frozen=True, eq=False)
class ConstrainedZonotope:
    """{x : (x, 0) in `lifted`}, of `states` dimensions; NaN of a set that is contradicted."""

    states: int
    lifted: Zonotope

    @cached_property
    def box(self) -> Zonotope:
        """The least box around it, as its linear programmes prove it."""
        n, centre = self.states, self.lifted.centre
        if np.isnan(centre).any():
            return Zonotope(centre[:n], np.full((n, n), np.nan))
        ends = np.array([self._end(sign * row) for sign in (1.0, -1.0) for row in np.eye(n)])
        above, below = ends[:n], -ends[n:]
        middle = 0.5 * (above + below)
        reach = np.abs(centre[:n]) + half_widths(self.lifted)[:n]
        width = np.maximum(above - middle, middle - below) + rounding_bound(1) * reach
        return Zonotope(middle, np.diag(width))

    def _end(self, direction: np.ndarray) -> float:
        """An upper bound of direction @ x."""
        n, (centre, generators) = self.states, self.lifted
        rows, values = generators[n:], -centre[n:]
        along, offset = direction @ generators[:n], float(direction @ centre[:n])
        tried = [np.zeros(len(rows))]
        if len(rows):
            tried += [along @ pseudo_inverse(rows), *_of_programme(along, rows, values)]
        return min(_proved(along, offset, each, rows, values) for each in tried)


def around(one: Zonotope) -> ConstrainedZonotope:
    """A zonotope (n,), without constraints."""
    return ConstrainedZonotope(len(one.centre), one)


def constrained_step(
    before: ConstrainedZonotope,
    evidence: StepReadings,
    generators: int = GENERATORS,
    constraints: int = CONSTRAINTS,
) -> ConstrainedZonotope:
    """The constrained zonotope of what becomes of a state in `before`, given the evidence.

    NaN where no state and noise within the bounds explain the readings.

    Args:
        generators: how many to keep, beside two for each constraint; n at least.
        constraints: how many readings to keep, the newest; the gain of the zonotope filter has cut
            the set with the others.
    """
    if np.isnan(before.lifted.centre).any():
        return before
    return _reduced(_tightened(joined(before, evidence)), generators, constraints)


def joined(before: ConstrainedZonotope, evidence: StepReadings) -> ConstrainedZonotope:
    """The set of what becomes of a state in `before`, with one more constraint for each reading;
    exact but for rounding."""
    motion, n = evidence.motion, before.states
    centre, columns = before.lifted
    reach = np.abs(centre[:n]) + half_widths(before.lifted)[:n]
    readings = [taken(part) for part in (evidence.exact, evidence.bounded)]
    maps = [motion, *readings]
    state, noise = (
        join_rows(*(part.state for part in maps)),
        join_rows(*(flat(part.noise) for part in maps)),
    )
    zeros = np.zeros(len(motion.state))
    values = join_entries(zeros, *(part.values for part in readings))
    size = join_entries(*(magnitudes(part, reach) for part in maps)) + np.abs(values)
    widths = join_entries(zeros, *(part.half_widths for part in readings))
    widths = widths + rounding_bound(noise.shape[-1] + columns.shape[-1] + n) * size
    # The constraints of before come last, as they were.
    older = columns[n:]
    generators = join_columns(
        join_rows(state @ columns[:n], older),
        join_rows(noise, np.zeros((len(older), noise.shape[-1]))),
        join_rows(np.diag(widths), np.zeros((len(older), len(widths)))),
    )
    middle = join_entries(state @ centre[:n] - values, centre[n:])
    return ConstrainedZonotope(len(motion.state), Zonotope(middle, generators))


def _tightened(one: ConstrainedZonotope) -> ConstrainedZonotope:
    """The same set with narrower generators, where constraints leave not all of [-1, 1] to them.

    NaN where they leave nothing, or where multipliers prove so. Scott et al. (2016), section 4.
    """
    n, (centre, generators) = one.states, one.lifted
    rows, values = generators[n:], -centre[n:]
    low, high = -np.ones(rows.shape[-1]), np.ones(rows.shape[-1])
    sizes = np.abs(rows)
    inverse = np.divide(1.0, rows, out=np.zeros_like(rows), where=rows != 0)
    for _ in range(_PASSES):
        middle, radius = 0.5 * (low + high), 0.5 * (high - low)
        spread = (sizes * radius).sum(-1, keepdims=True) - sizes * radius
        rest = (values - rows @ middle)[:, None]
        error = rounding_bound(len(low)) * (np.abs(values) + sizes.sum(-1))[:, None]
        at, by = middle + rest * inverse, np.abs(inverse) * (spread + error)
        seen = rows != 0
        low = np.maximum(low, np.where(seen, at - by, -1.0).max(0, initial=-1.0))
        high = np.minimum(high, np.where(seen, at + by, 1.0).min(0, initial=1.0))
        if (low > high).any():
            return _lost(one)
    if _is_empty(rows, values):
        return _lost(one)
    middle, radius = 0.5 * (low + high), 0.5 * (high - low)
    radius = np.minimum(radius * (1.0 + rounding_bound(2)) + rounding_bound(1), 1.0)
    moved = Zonotope(centre + generators @ middle, generators * radius)
    size = np.abs(centre) + half_widths(one.lifted)
    return ConstrainedZonotope(n, grown(moved, rounding_bound(len(low)) * size))


def _reduced(one: ConstrainedZonotope, generators: int, constraints: int) -> ConstrainedZonotope:
    """A constrained zonotope around it with so many rows and generators at most."""
    n, (centre, columns) = one.states, one.lifted
    if np.isnan(centre).any():
        return one
    # Of (x, y) with y = 0, x - gain y is x: the gain of the zonotope filter cuts x before it is
    # reduced, and rows then go as they are.
    gain = columns[:n] @ pseudo_inverse(columns[n:])
    size = np.abs(centre) + half_widths(one.lifted)
    error = rounding_bound(columns.shape[-1]) * (size[:n] + np.abs(gain) @ size[n:])
    kept = slice(n, n + constraints)
    cut = Zonotope(
        join_entries(centre[:n] - gain @ centre[n:], centre[kept]),
        join_rows(columns[:n] - gain @ columns[n:], columns[kept]),
    )
    cut = grown(cut, join_entries(error, np.zeros(len(cut.centre) - n)))
    rows = len(cut.centre) - n
    return ConstrainedZonotope(n, reduced(cut, max(generators, n) + 2 * rows))


def _lost(one: ConstrainedZonotope) -> ConstrainedZonotope:
    parts = (np.full_like(part, np.nan) for part in one.lifted)
    return ConstrainedZonotope(one.states, Zonotope(*parts))


# --- proofs --------------------------------------------------------------------------------------


def _proved(
    along: np.ndarray,
    offset: float,
    multipliers: np.ndarray,
    rows: np.ndarray,
    values: np.ndarray,
) -> float:
    """An upper bound of offset + along @ xi, |xi_i| <= 1, rows @ xi = values, by any multipliers.

    It is offset + m values + sum |along - m rows|, and rounding.
    """
    sizes = np.abs(multipliers)
    size = abs(offset) + np.abs(along).sum() + sizes @ (np.abs(values) + np.abs(rows).sum(-1))
    bound = offset + multipliers @ values + np.abs(along - multipliers @ rows).sum()
    return float(bound + rounding_bound(len(along) + len(values)) * size)


def _of_programme(along: np.ndarray, rows: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Multipliers of max along @ xi, as the solver has them and without its tolerance; none where
    it fails."""
    from scipy.optimize import linprog

    units, unit = row_units(rows), row_units(along[None])[0]
    scaled = rows / units[:, None]
    found = linprog(-along / unit, A_eq=scaled, b_eq=values / units, bounds=(-1.0, 1.0))
    if not found.success:
        return []
    # A generator that is not at an end of its range has no reduced cost.
    inside = np.abs(found.x) < 1.0 - _AT_END
    exact = np.linalg.lstsq(scaled[:, inside].T, along[inside], rcond=None)[0]
    return [-found.eqlin.marginals * unit / units, exact / units]


def _is_empty(rows: np.ndarray, values: np.ndarray) -> bool:
    """Whether multipliers prove that no |xi_i| <= 1 has rows @ xi = values."""
    if not len(rows) or np.abs(pseudo_inverse(rows) @ values).max() <= 1.0:
        return False
    found = _shortest(rows, values)
    if not found.success:
        return False
    # Those of the least t have m values = t sum |m rows|.
    multipliers = -found.eqlin.marginals / row_units(rows)
    return _proved(np.zeros(rows.shape[-1]), 0.0, multipliers, rows, values) < 0.0


def _shortest(rows: np.ndarray, values: np.ndarray) -> Any:
    """The programme of the least t with |xi_i| <= t and rows @ xi = values."""
    from scipy.optimize import linprog

    count = rows.shape[-1]
    units, one = row_units(rows), np.ones((count, 1))
    return linprog(
        np.append(np.zeros(count), 1.0),
        np.block([[np.eye(count), -one], [-np.eye(count), -one]]),
        np.zeros(2 * count),
        np.hstack([rows / units[:, None], np.zeros((len(rows), 1))]),
        values / units,
        bounds=(None, None),
    )
