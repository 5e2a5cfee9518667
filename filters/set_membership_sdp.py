"""The same ellipsoids by a semidefinite solver: a cross-check, and what others would do.

Needs the optional extra `convex` (cvxpy and clarabel), and only when called. Slow, and accurate to
what its solver reaches; no filter depends on it.

Source: Liu et al. (2021), theorem 1 and corollary 1 as printed, with the signs of (20).
"""

from typing import NamedTuple

import numpy as np

from filters.set_membership_multipliers import Problem


class Solution(NamedTuple):
    """What the solver returned: P (n, n), L (n, m), multipliers (c,), and its own verdict."""

    shape: np.ndarray
    gain: np.ndarray
    multipliers: np.ndarray
    status: str


class SolverFailed(RuntimeError):
    """The solver gave up; the message is its own."""


def solve_matrix_inequality(problem: Problem) -> Solution:
    """min tr P subject to [[M(tau), Gamma'], [Gamma, P]] >= 0, tau >= 0, in one lane.

    Gamma = image - L known. P, L and tau are all unknowns, as in the paper.

    Raises:
        ImportError: cvxpy is not installed.
        SolverFailed: no solution, not even an inaccurate one.
    """
    import cvxpy

    terms, image, known = problem.terms, problem.image, problem.known
    count, size = terms.shape[-3:-1]
    shape = cvxpy.Variable((len(image), len(image)), symmetric=True)
    gain = cvxpy.Variable((len(image), len(known)))
    multipliers = cvxpy.Variable(count, nonneg=True)
    certificate = np.diag(np.eye(size)[0])
    for i in range(count):
        certificate = certificate + multipliers[i] * terms[i]
    residual = image - gain @ known
    inequality = cvxpy.bmat([[certificate, residual.T], [residual, shape]])
    # Symmetric by construction, but the modelling layer cannot see it.
    programme = cvxpy.Problem(
        cvxpy.Minimize(cvxpy.trace(shape)), [0.5 * (inequality + inequality.T) >> 0]
    )
    try:
        programme.solve(solver=cvxpy.CLARABEL)
    except cvxpy.SolverError as error:
        raise SolverFailed(str(error)) from None
    if shape.value is None or gain.value is None or multipliers.value is None:
        raise SolverFailed(f"the solver ended with {programme.status!r} and no solution")
    return Solution(shape.value, gain.value, multipliers.value, str(programme.status))
