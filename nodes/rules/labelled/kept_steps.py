"""Results of the last steps, kept so that nodes of one process compute equal ones once."""

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Result = TypeVar("Result")


class KeptSteps(Generic[Result]):
    """The results of the last `steps` steps, each under all that it depends on.

    Nodes of one process share it. No result depends on what is kept: who asks gets what it would
    have computed.
    """

    def __init__(self, steps: int) -> None:
        self._steps, self._newest = steps, -1
        self._kept: dict[tuple[int, Hashable], Result] = {}

    def of(self, step: int, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Return the result of a step under a key, computed unless it is kept."""
        oldest = step - self._steps
        if step > self._newest or step <= self._newest - self._steps:
            # Much earlier steps are those of another run.
            self._newest = step
            self._kept = {k: kept for k, kept in self._kept.items() if oldest < k[0] <= step}
        if (step, key) not in self._kept:
            self._kept[step, key] = compute()
        return self._kept[step, key]
