"""A promise that a rule or a scenario gives, and the result of checking it."""

from collections.abc import Callable, Sequence
from typing import Generic, Literal, NamedTuple, TypeVar

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


def raised(error: Exception) -> str:
    """Return how a user's function failed."""
    return f"raises {type(error).__name__}: {error}"
