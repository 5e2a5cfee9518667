import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.linalg import (
    cholesky,
    inverse_spd,
    multiply,
    pack_upper,
    solve_spd,
    symmetrise,
    unpack_upper,
)
from tests.filters.support import BATCHES, random_spd

INDEFINITE = np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
SINGULAR = np.diag([1.0, 0.0, 1.0])
PARTLY_NAN = np.array([[1.0, np.nan, 0.0], [np.nan, 1.0, 0.0], [0.0, 0.0, 1.0]])
FAILURES = {
    "indefinite": INDEFINITE,
    "singular": SINGULAR,
    "negative": -np.eye(3),
    "partly nan": PARTLY_NAN,
    "last nan": np.diag([1.0, 1.0, np.nan]),
    "nan": np.full((3, 3), np.nan),
}


@pytest.mark.parametrize("lanes", BATCHES)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_factor_is_lower_triangular_and_squares_to_the_matrix(lanes, n):
    matrix = random_spd(np.random.default_rng(n), lanes, n)
    factor = cholesky(matrix)
    assert np.array_equal(factor, np.tril(factor))
    np.testing.assert_allclose(factor @ factor.mT, matrix, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("failure", FAILURES.values(), ids=FAILURES)
@pytest.mark.parametrize("function", [cholesky, inverse_spd])
def test_a_failed_lane_is_nan_throughout_and_alone(function, failure):
    matrix = random_spd(np.random.default_rng(1), (2, 3), 3)
    expected = function(matrix)
    matrix[1, 1] = failure
    result = function(matrix)
    assert np.isnan(result[1, 1]).all()
    assert np.isnan(function(failure)).all()
    expected[1, 1] = result[1, 1] = 0.0
    np.testing.assert_allclose(result, expected, rtol=1e-13, atol=1e-13)


def test_factor_refuses_what_is_not_square():
    with pytest.raises(np.linalg.LinAlgError):
        cholesky(np.ones((4, 2, 3)))


@pytest.mark.parametrize("lanes", [*BATCHES, (7, 11)])
def test_inverse_and_solution_undo_the_matrix(lanes):
    generator = np.random.default_rng(2)
    matrix = random_spd(generator, lanes, 4)
    right = generator.standard_normal((*lanes, 4, 3))
    inverse = inverse_spd(matrix)
    identity = np.broadcast_to(np.eye(4), matrix.shape)
    np.testing.assert_allclose(matrix @ inverse, identity, atol=1e-11)
    np.testing.assert_allclose(inverse, inverse.mT, rtol=1e-15)
    np.testing.assert_allclose(matrix @ solve_spd(matrix, right), right, atol=1e-11)


@given(n=st.integers(0, 7), lanes=st.sampled_from([*BATCHES, (0,)]), seed=st.integers(0, 2**16))
def test_packing_keeps_every_symmetric_matrix(n, lanes, seed):
    matrix = symmetrise(np.random.default_rng(seed).standard_normal((*lanes, n, n)))
    packed = pack_upper(matrix)
    assert packed.shape == (*lanes, n * (n + 1) // 2)
    np.testing.assert_array_equal(unpack_upper(packed), matrix)


def test_packing_order_is_row_by_row():
    matrix = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])
    np.testing.assert_array_equal(pack_upper(matrix), [1, 2, 3, 4, 5, 6])


def test_unpacking_refuses_a_length_that_is_no_triangle():
    with pytest.raises(ValueError, match="length 5"):
        unpack_upper(np.zeros((2, 5)))


def test_lanes_that_lie_along_memory_give_the_same():
    """Many lanes, as the filters leave them, and the same in the order of numpy."""
    generator = np.random.default_rng(4)
    rows = random_spd(generator, (2, 70), 3)
    vectors = generator.standard_normal((2, 70, 3))
    along = np.empty((3, 3, 2, 70)).transpose(2, 3, 0, 1)
    along[...] = rows
    np.testing.assert_allclose(multiply(along, vectors), multiply(rows, vectors), rtol=1e-13)
    packed = pack_upper(along)
    np.testing.assert_array_equal(packed, pack_upper(rows))
    np.testing.assert_array_equal(unpack_upper(packed), rows)
