"""The same ellipsoids by a semidefinite solver: a cross-check, and what others would do.

Needs the optional extra `convex` (cvxpy and clarabel), and only when called. Slow, and accurate to
what its solver reaches; no filter depends on it.

Source: Liu et al. (2021), theorem 1 and corollary 1 as printed, with the signs of (20).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.multipliers import Problem


class Solution(NamedTuple):
    """Result of the solver: P (n, n), L (n, m), multipliers (c,), and its own verdict."""

    shape: np.ndarray
    gain: np.ndarray
    multipliers: np.ndarray
    status: str


class SolverFailed(RuntimeError):
    """The solver gave up; the message is its own."""


def matrix_inequality(like: Problem) -> Callable[[Problem], Solution]:
    """A solver of min tr P subject to [[M(tau), Gamma'], [Gamma, P]] >= 0 and tau >= 0.

    P, L in Gamma = image - L known, and tau are all unknowns, as in the paper. For problems of one
    lane with the sizes of `like`: the programme is compiled once, with their numbers as parameters.

    Raises:
        ImportError: cvxpy is not installed.
        SolverFailed: by the function that is returned: no solution, not even an inaccurate one.
    """
    import cvxpy

    count, size = like.terms.shape[-3:-1]
    terms = [cvxpy.Parameter((size, size), symmetric=True) for _ in range(count)]
    image, known = cvxpy.Parameter(like.image.shape), cvxpy.Parameter(like.known.shape)
    shape = cvxpy.Variable((len(like.image), len(like.image)), symmetric=True)
    gain = cvxpy.Variable((len(like.image), len(like.known)))
    multipliers = cvxpy.Variable(count, nonneg=True)
    certificate = np.diag(np.eye(size)[0])
    for i, term in enumerate(terms):
        certificate = certificate + multipliers[i] * term
    residual = image - gain @ known
    inequality = cvxpy.bmat([[certificate, residual.T], [residual, shape]])
    # Symmetric by construction, but the modelling layer cannot see it.
    programme = cvxpy.Problem(
        cvxpy.Minimize(cvxpy.trace(shape)), [0.5 * (inequality + inequality.T) >> 0]
    )

    def solve(problem: Problem) -> Solution:
        for parameter, term in zip(terms, problem.terms, strict=True):
            parameter.value = 0.5 * (term + term.T)
        image.value, known.value = problem.image, problem.known
        try:
            programme.solve(solver=cvxpy.CLARABEL)
        except cvxpy.SolverError as error:
            raise SolverFailed(str(error)) from None
        if shape.value is None or gain.value is None or multipliers.value is None:
            raise SolverFailed(f"the solver ended with {programme.status!r} and no solution")
        return Solution(shape.value, gain.value, multipliers.value, str(programme.status))

    return solve
