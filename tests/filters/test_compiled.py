"""The choice of the compiled kernel, and that it fuses as numpy does."""

import sys
import types

import numpy as np
import pytest

from filters.fusion.averaging import INFORMATION
from filters.gaussian import Gaussian
from filters.kernels import compiled
from tests.filters.support import random_belief


@pytest.mark.skipif(compiled.KERNELS is None, reason="no compiled kernels")
@pytest.mark.parametrize("n", [1, 2, 4, 8])
@pytest.mark.parametrize("by_sharpness", [True, False])
@pytest.mark.parametrize("neighbours", [1, 4, 11])
def test_the_compiled_fusion_is_that_of_numpy(n, by_sharpness, neighbours, monkeypatch):
    generator = np.random.default_rng(n + neighbours)
    own, others = random_belief(generator, (), n), random_belief(generator, (neighbours,), n)
    weights = generator.uniform(size=1 + neighbours)
    weights[1] = 0.0
    # A belief with weight 0 may have any value, even NaN.
    given = Gaussian(np.where(np.arange(neighbours)[:, None] == 0, np.nan, others.mean), others.cov)
    call = own, given, weights / weights.sum(), by_sharpness
    ours = INFORMATION.fuse(*call)
    monkeypatch.setattr(compiled, "KERNELS", None)
    theirs = INFORMATION.fuse(*call)
    for one, other in zip((*ours.belief, *ours[1:]), (*theirs.belief, *theirs[1:]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(ours.belief.cov, ours.belief.cov.T)


def test_the_choice_of_kernels():
    assert compiled.choose("numpy") is None
    assert compiled.choose("") is compiled.KERNELS or compiled.KERNELS is None
    with pytest.raises(ValueError, match="CONCORD_KERNELS is 'fast', but must be numpy"):
        compiled.choose("fast")


def test_kernels_that_are_demanded_and_missing_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "concord_fast", None)
    assert compiled.choose("") is None
    with pytest.raises(ValueError, match="not installed"):
        compiled.choose("compiled")


def test_kernels_of_another_version_are_left_aside(monkeypatch):
    old = types.ModuleType("concord_fast")
    monkeypatch.setitem(sys.modules, "concord_fast", old)
    assert compiled.choose("") is None
    with pytest.raises(ValueError, match=r"built for another version of concord: .*make fast"):
        compiled.choose("compiled")
    monkeypatch.setattr(old, "INTERFACE", compiled.INTERFACE, raising=False)
    assert compiled.choose("compiled") is old
