"""A promise that a rule or a scenario gives, and the result of checking it."""

import warnings
from collections.abc import Callable, Sequence
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np

Subject = TypeVar("Subject")
Status = Literal["holds", "BROKEN", "note", "skipped"]


class PromiseResult(NamedTuple):
    """Result of a promise.

    Attributes:
        status: a note breaks no promise; skipped is a promise that does not apply.
        seen: what was found.
        case: number of the case that broke it; None if none did.
        again: command that repeats the case; "" if `concord check` itself does.
        values: the smallest case in numbers, for promises about beliefs.
    """

    status: Status
    seen: str
    case: int | None = None
    again: str = ""
    values: dict[str, list[float]] | None = None


class Promise(NamedTuple, Generic[Subject]):
    """A promise: its name, a sentence, and a check of numbered cases."""

    name: str
    says: str
    check: Callable[[Subject, Sequence[int]], PromiseResult]


class PromiseBroken(Exception):
    """The fault of a result, where the check cannot go on."""


def fault_of(check: Callable[[], str]) -> str:
    """Return the fault that a check finds, or how a user's function fails in it; "" for none."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            return check()
        except PromiseBroken as fault:
            return str(fault)
        except Exception as error:  # a user's function may raise anything
            return raised(error)


def covariance_fault(mean: np.ndarray, cov: np.ndarray, rounding: float) -> str:
    """Return why a result of sound beliefs is no belief, "" if it is one."""
    if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        return "sound beliefs give a result that is not finite"
    deviation = np.sqrt(np.abs(np.diagonal(cov, axis1=-2, axis2=-1)))
    skew = np.abs(cov - cov.mT) - rounding * deviation[..., None] * deviation[..., None, :]
    if (skew > 0).any():
        return f"the covariance is not symmetric, by {np.abs(cov - cov.mT).max():.3g}"
    least = float(np.linalg.eigvalsh(cov).min())
    return "" if least > 0 else f"the covariance has an eigenvalue of {least:.3g}"


def amount(off: float) -> str:
    """Return in words by how much beliefs are apart (`apart`)."""
    return f"by {off:.3g} standard deviations" if np.isfinite(off) else "from or to NaN"


def raised(error: Exception) -> str:
    """Return how a user's function failed."""
    return f"raises {type(error).__name__}: {error}"
