"""The comparisons that Liu et al. (2021) lack: sets hold the truth, theory orders the sizes."""

import numpy as np
import pytest

from concord.papers.liu2021.comparisons import by_shape, by_slots, multipliers_apart
from concord.papers.liu2021.runs import ESTIMATORS, simulate

pytestmark = pytest.mark.slow


def test_every_protocol_has_sets_that_hold_the_state():
    pairs = by_slots(seed=2, sequences=2)
    assert [one.sets for one, _ in pairs] == [3 * 60 // (slots + 1) for slots in range(5)]
    assert sum(one.outside + other.outside for one, other in pairs) == 0
    assert all(other.half_widths < one.half_widths for one, other in pairs)


def test_a_wider_bound_makes_wider_sets():
    batch = simulate(seed=1, sequences=0, cycles=6)
    for pair in zip(*by_shape(batch), strict=True):
        widths = [one.half_widths for one in pair]
        assert widths == sorted(widths)
        # Only the ellipsoid of the first state keeps the sets from scaling with the root of W.
        assert 2 < widths[2] / widths[0] < np.sqrt(10 / 0.09)


def test_a_multiplier_for_each_sample_is_never_worse_in_the_first_cycle():
    batch = simulate(seed=5, sequences=6, cycles=4)
    apart = multipliers_apart(batch, {n: ESTIMATORS[n](batch) for n in ("paper", "tight")})
    together, each, cut = apart.values()
    # Equal multipliers are allowed, and the first cycle begins with the same ellipsoid.
    assert (each.trace[0] <= together.trace[0] * (1 + 1e-6)).all()
    assert each.trace.mean() < 0.9 * together.trace.mean()
    assert cut.trace.mean() < each.trace.mean()
    assert each.violations.sum() == 0
