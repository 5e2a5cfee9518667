"""A case that breaks an invariant, made as small as it goes while it still breaks the same one."""

import shlex
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from concord.experiments.simulation_testing.case import (
    SimulationCase,
    check_case,
    differences,
    with_fields,
)
from concord.experiments.simulation_testing.draw import draw_case
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import in_options

MOST_TRIES = 200
FEWEST_NODES = 2

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


def shrink(case: SimulationCase, breaks: Callable[[SimulationCase], bool]) -> SimulationCase:
    """Return the smallest case found in which the invariant still breaks; `breaks` runs one."""
    tries = 0
    progress = True
    while progress:
        progress = False
        for fields in _smaller(case):
            smaller = _with(case, fields)
            if smaller is None or smaller == case:
                continue
            if tries == MOST_TRIES:
                return case
            tries += 1
            if breaks(smaller):
                case, progress = smaller, True
                break
    return case


def _smaller(case: SimulationCase) -> Iterator[dict[str, Any]]:
    """Fields of cases with less in them, those with much less first."""
    scenario = case.scenario
    # Steps come first: whatever is tried after them takes no longer than they do.
    for steps in _between(1, scenario.steps):
        changes = tuple(line for line in scenario.changes if int(line.split()[0]) < steps)
        yield {"steps": steps, "changes": changes}
    for nodes in _between(FEWEST_NODES, scenario.nodes):
        yield {"nodes": nodes}
    yield from ({"changes": kept} for kept in _fewer(scenario.changes))
    yield from ({"wire": kept} for kept in _fewer(case.wire))
    yield from _PLAIN


def _fewer(values: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
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


def _with(case: SimulationCase, fields: dict[str, Any]) -> SimulationCase | None:
    """Return the case with other fields; None where they go with no case."""
    try:
        changed = with_fields(case, fields)
        prepare(changed.scenario)
        check_case(changed)
    except ValueError:
        return None
    return changed


def replay_command(case: SimulationCase) -> str:
    """Return the command that repeats a case exactly."""
    said: dict[str, Any] = {}
    while case != (drawn := draw_case(case.seed, said)):
        # A given field may change the fields that are drawn after it.
        said |= differences(case, drawn)
    words = ["concord", "simulation-testing", "--seeds", str(case.seed)]
    for name, value in said.items():
        words += ["--" + name.replace("_", "-"), written(value)]
    return shlex.join(words)


def run_command(case: SimulationCase) -> str:
    """Return the command that runs and records the scenario of a case, in any driver.

    The command leaves out the faults of the wire, which only simulation testing can produce.
    """
    scenario = case.scenario
    return shlex.join(["concord", "run", "--scenario", scenario.name, *in_options(scenario)])


def written(value: object) -> str:
    """A value as the options of the command read it."""
    if isinstance(value, tuple):
        return ", ".join(value)
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()
