"""Values that describe a plant of the user's own: vectors, covariances, names."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def numbers_of(name: str, given: Any) -> np.ndarray:
    """Return an array of numbers, of a list, an array, a sparse matrix of scipy or a DataArray;
    `name` is that of the argument in messages."""
    dense = given.toarray() if hasattr(given, "toarray") else given
    try:
        return np.asarray(dense, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name}{_shown(given)} of type {type(given).__name__}: it holds no real numbers, or "
            "rows of several lengths; give a list or an array of numbers"
        ) from None


def _shown(given: Any) -> str:
    return f" {given!r}" if isinstance(given, str | bytes) and len(given) < 40 else ""


def require_description(
    states: int, time_step_s: float, names: Sequence[str], units: Sequence[str]
) -> None:
    """Refuse a time step of 0 or less, and names or units that are not those of all states."""
    if not (isinstance(time_step_s, int | float | np.number) and 0 < time_step_s < np.inf):
        raise ValueError(f"time_step_s {time_step_s}: must be above 0, and finite")
    for field, given in (("state_names", names), ("state_units", units)):
        if isinstance(given, str) or not isinstance(given, Sequence):
            raise ValueError(f"{field} {given}: must be a tuple of texts, one for each state")
        if given and len(given) != states:
            raise ValueError(f"{field} {given}: must have {states} entries, one for each state")


def require_parameters(given: Any) -> None:
    """Refuse parameters that are no (value, low, high) by name, or a value outside its bounds."""
    for name, one in given.items():
        try:
            value, low, high = map(float, one)
        except (TypeError, ValueError):
            raise ValueError(f"parameters {name}: {one}: must be (value, low, high)") from None
        if not (low <= value <= high and low < high and np.isfinite([low, high]).all()):
            raise ValueError(
                f"parameters {name}: {one}: must be (value, low, high), finite, with the value "
                "between the others"
            )


def vector_of(name: str, given: ArrayLike) -> np.ndarray:
    """Return a vector (n,) of finite numbers; `name` is that of the argument in messages."""
    vector = np.atleast_1d(numbers_of(name, given))
    if vector.ndim != 1 or not len(vector) or not np.isfinite(vector).all():
        raise ValueError(f"{name} {given}: must be a vector of finite numbers")
    return vector


def covariance_of(name: str, given: ArrayLike, size: int | None = None) -> np.ndarray:
    """Return a covariance (size, size) of a matrix or its diagonal; `name` as in `vector_of`.

    Without a size, any will do.
    """
    matrix = numbers_of(name, given)
    if matrix.ndim < 2:
        matrix = np.diag(np.atleast_1d(matrix))
    size = len(matrix) if size is None else size
    if matrix.shape != (size, size):
        raise ValueError(
            f"{name} of shape {np.shape(given)}: must be {(size, size)}, or its diagonal {(size,)}"
        )
    largest = np.abs(matrix).max(initial=0.0)
    if not np.isfinite(matrix).all() or np.abs(matrix - matrix.T).max() > 1e-8 * largest:
        raise ValueError(f"{name}: must be finite and symmetric")
    if np.linalg.eigvalsh(matrix).min() < -1e-12 * largest:
        raise ValueError(f"{name}: has a negative eigenvalue; a covariance has none")
    return matrix


_LEAST_PROBABILITY, _LEAST_THRESHOLD = 0.7, 0.5


def gate_threshold(gate: float, entries: int) -> float:
    """Chi-square threshold of a gate, which is a probability or the threshold.

    Probabilities are below 1 and thresholds above, so that neither is taken for the other.

    Raises:
        ValueError: a gate that is no number, or that would refuse too many sound readings.
    """
    # Only here: most sensors have no gate, and scipy takes longer to load than most commands take.
    from scipy.special import chdtr, chdtri

    if not np.isfinite(gate) or gate <= 0 or gate == 1:
        raise ValueError(
            f"gate {gate}: give the probability that a sound reading passes, such as 0.99, or a "
            "chi-square threshold such as 6.63"
        )
    if gate < 1:
        if gate < _LEAST_PROBABILITY:
            raise ValueError(
                f"gate {gate:g}: as a probability it would refuse {100 * (1 - gate):.3g} % of the "
                f"sound readings; give {_LEAST_PROBABILITY:g} or more, such as 0.99"
            )
        return float(chdtri(entries, 1 - gate))
    if (passed := float(chdtr(entries, gate))) < _LEAST_THRESHOLD:
        raise ValueError(
            f"gate {gate:g}: as a threshold for {entries} entries it would refuse "
            f"{100 * (1 - passed):.3g} % of the sound readings; give a probability such as 0.99"
        )
    return float(gate)
