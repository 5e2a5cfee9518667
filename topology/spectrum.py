"""Eigenvalues of graphs and weights: dense where that is quick, else by Lanczos and Arnoldi.

Sparse iterations start from a fixed vector, so that equal matrices give equal bits.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph, csr_array, eye_array
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, eigsh

from concord.topology.adjacency import nodes_of

# Up to here all eigenvalues take less than a second.
DENSE_NODES = 600
# Limit of a sparse iteration; after it, the slow ends of the spectrum use shift and invert.
_ITERATIONS = 60
# Beside an eigenvalue, so that the shifted matrix can be factorised.
_BESIDE = 1e-7


def second_eigenvalue_modulus(weights: csr_array | np.ndarray) -> float:
    """Second largest modulus among the eigenvalues of row-stochastic weights (n, n).

    By this factor disagreement falls per round in the long run (Xiao, Boyd 2004, the asymptotic
    convergence factor); 0 for one node.
    """
    nodes = nodes_of(weights)
    if nodes <= DENSE_NODES:
        moduli = np.abs(_others(np.linalg.eigvals(_dense(weights))))
    else:
        moduli = np.abs(_others(_outermost(csr_array(weights))))
    return min(float(moduli.max(initial=0.0)), 1.0)


def eigenvalues(weights: csr_array | np.ndarray) -> NDArray[np.complex128]:
    """All eigenvalues of weights (n, n), by falling modulus; for graphs that can be dense.

    Raises:
        ValueError: more than `DENSE_NODES` nodes.
    """
    nodes = nodes_of(weights)
    if nodes > DENSE_NODES:
        raise ValueError(
            f"all eigenvalues of {nodes} nodes: they are computed for at most {DENSE_NODES}; "
            "ask for a smaller graph"
        )
    values = np.linalg.eigvals(_dense(weights)).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


def contraction_per_round(weights: csr_array | np.ndarray) -> float:
    """The largest part of a disagreement that one round of row-stochastic weights (n, n) leaves.

    With P the projection onto disagreements this is `|P W|`; of doubly stochastic weights it is
    `|W - 11'/n|`, the per-step convergence factor of Xiao, Boyd 2004, and symmetric ones have it
    equal to the second eigenvalue modulus.
    """
    nodes = nodes_of(weights)
    if nodes <= DENSE_NODES:
        dense = _dense(weights)
        return float(np.linalg.norm(dense - dense.mean(axis=0), ord=2))
    matrix = csr_array(weights)
    if _is_symmetric(matrix):
        return second_eigenvalue_modulus(matrix)

    def squared(values: np.ndarray) -> np.ndarray:
        left = matrix @ values
        return matrix.T @ (left - left.mean())

    return float(np.sqrt(_largest(squared, nodes)))


def laplacian_bounds(adjacency: csr_array) -> tuple[float, float]:
    """The second smallest (algebraic connectivity, Fiedler 1973) and the largest eigenvalue of the
    Laplacian of a connected undirected graph (n, n) of two nodes or more."""
    laplacian = csr_array(csgraph.laplacian(csr_array(adjacency, dtype=float)))
    nodes = nodes_of(laplacian)
    if nodes <= DENSE_NODES:
        values = np.linalg.eigvalsh(laplacian.toarray())
        return float(values[1]), float(values[-1])
    # A crowd at this end does not matter: any of it is as good within the tolerance.
    largest = float(_solved(eigsh, laplacian, k=1, which="LA", tol=1e-6)[0])
    flipped = csr_array(largest * eye_array(nodes) - laplacian)
    try:
        near = largest - _solved(eigsh, flipped, k=2, which="LA", maxiter=_ITERATIONS)
    except ArpackNoConvergence:
        near = _solved(eigsh, laplacian, k=2, sigma=-_BESIDE)
    return float(near.max()), largest


def vote_of(weights: csr_array | np.ndarray, rounds: int, counted: np.ndarray) -> float:
    """The spectral radius of W^rounds D, D the diagonal of `counted` (n,), none of them below 0:
    what these nodes have left of their own after that many rounds."""
    nodes = nodes_of(weights)
    if nodes <= DENSE_NODES:
        powered = np.linalg.matrix_power(_dense(weights), rounds)
        return float(np.abs(np.linalg.eigvals(powered * counted)).max())

    def once(values: np.ndarray) -> np.ndarray:
        values = values * counted
        for _ in range(rounds):
            values = weights @ values
        return values

    operator = LinearOperator((nodes, nodes), matvec=once, dtype=float)  # type: ignore[call-arg]
    found = _solved(eigs, operator, k=1, tol=1e-6)
    return float(np.abs(found).max())


def _others(values: NDArray) -> NDArray:
    """Eigenvalues of row-stochastic weights without the 1 that all have, by what lies nearest."""
    return np.delete(values, np.argmin(np.abs(values - 1)))


def _outermost(weights: csr_array) -> NDArray:
    """Eigenvalues of large modulus, the largest two among them."""
    solve = eigsh if _is_symmetric(weights) else eigs
    try:
        return _solved(solve, weights, k=6, which="LM", maxiter=_ITERATIONS)
    except ArpackNoConvergence:
        # Eigenvalues crowd at 1: look there with a shifted and inverted matrix, and at -1 only as
        # well as tells whether any of them is as large.
        near = _solved(solve, weights, k=4, sigma=1 + _BESIDE)
        far = _solved(solve, weights, k=2, sigma=-1 - _BESIDE, tol=1e-3)
        return np.concatenate((near, far))


def _is_symmetric(matrix: csr_array) -> bool:
    return abs(matrix - matrix.T).max() < 1e-12


def _largest(apply: Callable[[np.ndarray], np.ndarray], nodes: int) -> float:
    operator = LinearOperator((nodes, nodes), matvec=apply, dtype=float)  # type: ignore[call-arg]
    return float(_solved(eigsh, operator, k=1)[0])


def _solved(solve: Callable[..., Any], matrix: Any, **options: Any) -> NDArray:
    """Eigenvalues by `eigs` or `eigsh`."""
    # A beginning that no symmetry of a graph leaves without a part in any eigenvector.
    start = np.random.default_rng(matrix.shape[0]).normal(size=matrix.shape[0])
    return solve(matrix, v0=start, ncv=80, return_eigenvectors=False, **options)


def _dense(weights: csr_array | np.ndarray) -> np.ndarray:
    return weights.toarray() if isinstance(weights, csr_array) else np.asarray(weights, dtype=float)
