"""The three ways of computing a batch agree, whatever the rule, the angles, the failures."""

import sys
import types

import numpy as np
import pytest

from filters import compiled, linalg, paths, ukf, ukf_columns, ukf_compiled, ukf_lane, ukf_stack
from filters.columns import MANY_LANES
from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule, gauss_hermite, scaled_unscented
from tests.filters.support import (
    RULE_NAMES,
    bearing_residual,
    random_belief,
    random_spd,
    rules,
    wrap,
)

# Not a multiple of what the compiled kernels take at once, and a multiple of it in the first axis.
LANES = (8, 5)
ARRAY_PATHS = [
    pytest.param(ukf_columns, id="columns"),
    pytest.param(
        ukf_compiled,
        id="compiled",
        marks=pytest.mark.skipif(compiled.KERNELS is None, reason="no compiled kernels"),
    ),
]


def bend(points):
    """A curved map of the state onto itself."""
    after = np.empty_like(points)
    after[...] = np.sin(points) + 0.3 * points * points[..., ::-1]
    return after


def sense(m):
    def measure(points):
        values = np.empty_like(points, shape=(*points.shape[:-1], m))
        for i in range(m):
            values[..., i] = np.arctan2(points[..., i], 2 + np.cos(points[..., -1]))
        return values

    return measure


def turned(a, b):
    return wrap(a - b)


@pytest.fixture
def numpy_alone(monkeypatch):
    monkeypatch.setattr(compiled, "KERNELS", None)


def lane_by_lane(call, *arrays):
    """What a function of one lane makes of every lane, put together."""
    results = [call(*(array[lane] for array in arrays)) for lane in np.ndindex(LANES)]
    return [np.reshape(part, (*LANES, *np.shape(part[0]))) for part in zip(*results, strict=True)]


def agree(one, other):
    np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("array_path", ARRAY_PATHS)
@pytest.mark.parametrize("n", [1, 2, 4, 6])
@pytest.mark.parametrize("name", RULE_NAMES[:3])
def test_predictions_agree(name, n, array_path, numpy_alone):
    generator = np.random.default_rng(n)
    belief, rule = random_belief(generator, LANES, n), rules(n)[name]
    noise = random_spd(generator, LANES, n)
    for residual in (np.subtract, turned):
        expected = ukf_stack.predict(belief, bend, noise, rule, residual)

        def alone(mean, cov, noise, residual=residual):
            return ukf_lane.predict(Gaussian(mean, cov), bend, noise, rule, residual)

        for ours, theirs in zip(lane_by_lane(alone, *belief, noise), expected, strict=True):
            agree(ours, theirs)
        after = array_path.predict(belief, bend, noise, rule, residual)
        for ours, theirs in zip(after, expected, strict=True):
            agree(ours, theirs)
        shared = array_path.predict(belief, bend, noise[0, 0], rule, residual)
        agree(shared.cov, ukf_stack.predict(belief, bend, noise[0, 0], rule, residual).cov)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("name", RULE_NAMES)
@pytest.mark.parametrize("state_residual", [np.subtract, turned], ids=["plain", "turned"])
@pytest.mark.parametrize("array_path", ARRAY_PATHS)
def test_measurement_moments_and_corrections_agree(
    name, m, state_residual, array_path, numpy_alone
):
    n = 3
    generator = np.random.default_rng(m)
    belief, rule = random_belief(generator, LANES, n), rules(n)[name]
    noise, readings = random_spd(generator, LANES, m), generator.standard_normal((*LANES, m))
    rest = rule, turned, state_residual
    expected = ukf_stack.expect(belief, sense(m), m, noise, *rest)
    innovation = readings - expected[0]
    posterior, squared = ukf_stack.correct(belief, innovation, *expected[1:])

    def alone(mean, cov, noise, reading):
        prior = Gaussian(mean, cov)
        predicted, *covs = ukf_lane.expect(prior, sense(m), m, noise, *rest)
        after, squared = ukf_lane.correct(prior, reading - predicted, *covs)
        return predicted, *covs, *after, squared

    every = lane_by_lane(alone, *belief, noise, readings)
    for ours, theirs in zip(every, [*expected, *posterior, squared], strict=True):
        agree(ours, theirs)
    if rule.reach is not None:
        moments = array_path.expect(belief, sense(m), m, noise, *rest)
        after, nis = array_path.correct(belief, innovation, *moments[1:])
        for ours, theirs in zip(
            [*moments, *after, nis], [*expected, *posterior, squared], strict=True
        ):
            agree(ours, theirs)


@pytest.mark.parametrize("failing", [0, 2])
@pytest.mark.parametrize("array_path", ARRAY_PATHS)
def test_lanes_that_fail_are_nan_alone_in_every_way(failing, array_path, numpy_alone):
    """Not definite from the first pivot on, or at the last alone."""
    generator, rule = np.random.default_rng(5), rules(3)["unscented"]
    belief = random_belief(generator, (5,), 3)
    healthy = ukf_stack.predict(belief, np.copy, np.eye(3), rule, np.subtract)
    belief.cov[1, failing, failing] = -1.0
    belief.cov[3] = np.nan
    # A model that mixes nothing: what is broken in one component must show in all.
    for path in (ukf_stack, array_path):
        mean, cov = path.predict(belief, np.copy, np.eye(3), rule, np.subtract)
        assert np.isnan(mean[[1, 3]]).all() and np.isnan(cov[[1, 3]]).all()
        agree(mean[[0, 2, 4]], healthy.mean[[0, 2, 4]])
        innovation_cov = np.broadcast_to(np.eye(2), (5, 2, 2)).copy()
        innovation_cov[0, 1, 1] = innovation_cov[2, 0, 0] = 0.0
        after, squared = path.correct(belief, np.ones((5, 2)), innovation_cov, np.ones((5, 3, 2)))
        lost = np.isnan(squared)
        assert lost.tolist() == [True, False, True, False, False]
        assert np.isnan(after.mean[[0, 2]]).all() and np.isfinite(after.mean[[1, 4]]).all()
    broken = ukf_lane.predict(
        Gaussian(belief.mean[1], belief.cov[1]), np.copy, np.eye(3), rule, np.subtract
    )
    assert np.isnan(broken.mean).all() and np.isnan(broken.cov).all()


def test_a_whole_step_is_the_same_below_and_above_the_change_of_way():
    generator, rule = np.random.default_rng(7), rules(4)["unscented"]
    lanes = 2 * MANY_LANES
    belief = random_belief(generator, (lanes,), 4)
    readings = generator.standard_normal((lanes, 2))
    readings[3], readings[5, 1] = np.nan, np.nan

    def step(part):
        prior = Gaussian(belief.mean[part], belief.cov[part])
        predicted = ukf.predict(prior, bend, np.eye(4), rule)
        result = ukf.update(
            predicted, readings[part], sense(2), np.eye(2), rule, residual=bearing_residual
        )
        return *result.belief, *result[1:]

    together = step(slice(None))
    for begin in range(0, lanes, 10):
        part = slice(begin, begin + 10)
        for ours, theirs in zip(step(part), together, strict=True):
            agree(ours, theirs[part])


def test_results_of_many_lanes_keep_lanes_contiguous():
    """So that a chain of steps never turns its memory over."""
    belief = random_belief(np.random.default_rng(1), (2, MANY_LANES), 3)
    seen = []

    def remember(points):
        seen.append(points[..., 0].flags.c_contiguous)
        return np.copy(points, order="K")

    mean, cov = ukf.predict(belief, remember, np.eye(3), rules(3)["unscented"])
    assert seen == [True]
    assert mean.transpose(2, 0, 1).flags.c_contiguous
    assert cov.transpose(2, 3, 0, 1).flags.c_contiguous


def test_each_size_has_its_way(numpy_alone):
    generator, rule = np.random.default_rng(1), rules(2)["cubature"]
    ways = {(): ukf_lane, (1, 1): ukf_lane, (2,): ukf_stack, (MANY_LANES,): ukf_columns}
    for lanes, way in ways.items():
        belief = random_belief(generator, lanes, 2)
        assert paths.path_of_transform(belief, np.eye(2), rule) is way
        assert paths.path_of_correction(belief, np.zeros((*lanes, 1))) is way
    many = random_belief(generator, (MANY_LANES,), 2)
    assert paths.path_of_transform(many, np.eye(2), gauss_hermite(2, 3)) is ukf_stack
    shared = Gaussian(many.mean, many.cov[0])
    assert paths.path_of_transform(shared, np.eye(2), rule) is ukf_stack


@pytest.mark.skipif(compiled.KERNELS is None, reason="no compiled kernels")
def test_compiled_kernels_serve_every_batch_of_their_sizes():
    generator = np.random.default_rng(1)
    for n, m, way in ((2, 1, ukf_compiled), (8, 8, ukf_compiled), (9, 1, ukf_lane)):
        belief, rule = random_belief(generator, (), n), rules(n)["unscented"]
        assert paths.path_of_transform(belief, np.eye(m), rule) is way
        assert paths.path_of_correction(belief, np.zeros(m)) is way


@pytest.mark.skipif(compiled.KERNELS is None, reason="no compiled kernels")
@pytest.mark.parametrize("name", ["cholesky", "inverse_spd"])
@pytest.mark.parametrize("lanes", [(), (3,), (70,), (5, 4)])
def test_compiled_matrices_are_those_of_numpy(name, lanes, monkeypatch):
    """However the lanes lie in memory."""
    matrix = random_spd(np.random.default_rng(2), (*lanes, 2), 4)
    for given in (matrix[..., 0, :, :], np.asfortranarray(matrix)[..., 1, :, :]):
        ours = getattr(linalg, name)(given)
        with monkeypatch.context() as patch:
            patch.setattr(compiled, "KERNELS", None)
            agree(ours, getattr(linalg, name)(given))


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


def test_a_rule_with_other_weights_for_the_covariance_beyond_its_first_point_is_refused():
    with pytest.raises(ValueError, match="positive and alike"):
        SigmaPointRule(np.zeros((3, 1)), np.array([0.0, 0.5, 0.5]), np.array([0.0, 1.0, 1.0]))


@pytest.mark.parametrize("beta", [0.0, 2.0])
def test_one_lane_with_a_centre_that_weighs_less_than_nothing(beta):
    """Then the covariance is no square of anything, and may not be positive definite."""
    generator, rule = np.random.default_rng(9), scaled_unscented(5, beta=beta)
    assert (rule.moment_root is None) == (beta == 0.0)
    belief = random_belief(generator, (), 5)
    ours = ukf_lane.predict(belief, bend, np.eye(5), rule, np.subtract)
    for one, other in zip(
        ours, ukf_stack.predict(belief, bend, np.eye(5), rule, np.subtract), strict=True
    ):
        agree(one, other)
    np.testing.assert_array_equal(ours.cov, ours.cov.T)
