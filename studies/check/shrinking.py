"""The smallest network in which a finding still shows."""

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario

Shrunk = TypeVar("Shrunk")
MOST_TRIES = 200
_FEWEST_NODES = 2

# Plain values in the order of trial: one value of each field, so that the search ends.
_PLAIN: tuple[dict[str, Any], ...] = (
    {"scenario": "oscillator"},
    {"rule": "ci"},
    {"links": "static"},
    {"loss": 0.0},
    {"schedule": "full"},
    {"relay": False},
    {"channels": "all"},
    {"cluster": "fitted"},
    {"arbiter": "wtod"},
    {"trigger": 0.0},
    {"rounds": 1},
    {"graph": "path"},
    {"weights": "metropolis"},
    {"hold": "decayed"},
    {"decay": 0.5},
    {"determinant_weights": True},
    {"number": "float64"},
    {"window_steps": None},
    {"digest_steps": None},
    {"record_number": "int16"},
    {"payload_bytes": 254},
    {"seed": 1},
)  # fmt: skip


def shrink(
    value: Shrunk,
    smaller: Callable[[Shrunk], Iterator[Shrunk]],
    breaks: Callable[[Shrunk], bool],
) -> Shrunk:
    """Return the smallest value found that still breaks a promise; `breaks` runs one."""
    tries, progress = 0, True
    while progress:
        progress = False
        for tried in smaller(value):
            if tries == MOST_TRIES:
                return value
            tries += 1
            if breaks(tried):
                value, progress = tried, True
                break
    return value


def smaller_networks(scenario: Scenario) -> Iterator[Scenario]:
    """Yield networks that can run and have less in them, those with much less first."""
    for fields in _smaller(scenario):
        try:
            smaller, _ = scenario.with_known(**fields)
            prepare(smaller, tries_rule=False)
        except ValueError:
            continue
        if smaller != scenario:
            yield smaller


def _smaller(scenario: Scenario) -> Iterator[dict[str, Any]]:
    # Steps come first: whatever is tried after them takes no longer than they do.
    for steps in _between(1, scenario.steps):
        changes = tuple(line for line in scenario.changes if int(line.split()[0]) < steps)
        yield {"steps": steps, "changes": changes}
    for nodes in _between(_FEWEST_NODES, scenario.nodes):
        yield {"nodes": nodes}
    yield from ({"changes": kept} for kept in fewer(scenario.changes))
    yield from _PLAIN


def fewer(values: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Without a part of them: halves, then quarters, down to single ones."""
    size = len(values)
    while size:
        for first in range(0, len(values), size):
            yield values[:first] + values[first + size :]
        size //= 2


def _between(least: int, value: int) -> Iterator[int]:
    """Numbers below a value, the least first, in ever smaller steps."""
    gap = value - least
    while gap:
        yield value - gap
        gap //= 2
