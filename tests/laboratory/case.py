"""A case of simulation testing from its seed: a network, a swarm of faults, and a faulty wire.

Swarm testing: a case has some of the kinds of faults, each at its own rate, so that no kind hides
what another would bring to light.

Source: Groce, Zhang, Eide, Chen and Regehr (2012), Swarm testing, ISSTA.
"""

import shlex
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
import numpy as np

from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import in_options, offered_options
from concord.scenarios.script import script_of
from concord.scenarios.types.assignment import flat
from concord.studies.check import shrinking
from concord.studies.check.drawn_networks import generator_of, possible_networks
from concord.topology.names import unknown_name
from tests.laboratory.script import calm_from, draw_script
from tests.laboratory.verdict import RECOVERY_STEPS
from tests.laboratory.wire import WIRE_FAULTS, read_wire

_MOST_CALM = 16


class SimulationCase(msgspec.Struct, frozen=True):
    """Equal cases give equal runs, bit for bit.

    Attributes:
        seed: of what the wire does to messages.
        scenario: what is simulated; its `changes` are faults and their ends.
        wire: kinds and probabilities, "garbage 0.2" (`wire`).
    """

    seed: int
    scenario: Scenario
    wire: tuple[str, ...]

    @property
    def calm_step(self) -> int:
        """First step after the end of all faults."""
        return calm_from(script_of(self.scenario), self.scenario.steps)

    def with_fields(self, fields: Mapping[str, Any]) -> "SimulationCase":
        """Return the case with these fields, `wire` or those of its scenario."""
        others = {name: value for name, value in fields.items() if name != "wire"}
        scenario, _ = self.scenario.with_known(**others)
        return SimulationCase(self.seed, scenario, fields.get("wire", self.wire))

    @property
    def fields(self) -> dict[str, Any]:
        """Return all fields by the names of options."""
        return {**flat(self.scenario), "wire": self.wire}


def draw_case(seed: int, fixed: Mapping[str, Any]) -> SimulationCase:
    """Return the case of a seed, of which some fields are fixed.

    Raises:
        ValueError: no scenario has these fields.
    """
    refusal = ValueError("nothing was tried")
    for attempt, generator, drawn in possible_networks(seed):
        # The fixed fields must not decide which attempt is used; otherwise a case that was made
        # smaller would be a different case.
        try:
            return _completed(seed, attempt, generator, drawn, fixed)
        except ValueError as error:
            refusal = error
    raise refusal


def _completed(
    seed: int,
    attempt: int,
    generator: np.random.Generator,
    drawn: Scenario,
    fixed: Mapping[str, Any],
) -> SimulationCase:
    """Return the case whose scenario was drawn, with what is fixed."""
    calm_step = int(generator.integers(4, _MOST_CALM))
    drawn = msgspec.structs.replace(drawn, steps=calm_step + RECOVERY_STEPS)
    case = SimulationCase(seed, drawn, _draw_wire(generator))
    known = {*offered_options(), "wire"}
    for name in fixed:
        if name not in known:
            raise unknown_name("option", name, known)
    case = case.with_fields({name: value for name, value in fixed.items() if name != "changes"})
    setup = prepare(case.scenario)
    changes = fixed.get("changes")
    if changes is None:
        calm_step = min(calm_step, case.scenario.steps - 1)
        changes = draw_script(generator_of(seed, attempt, 1), setup, calm_step)
    case = case.with_fields({"changes": tuple(changes)})
    prepare(case.scenario)
    read_wire(case.wire)
    return case


def _draw_wire(generator: np.random.Generator) -> tuple[str, ...]:
    """Some kinds, each with a probability between rarely and mostly."""
    return tuple(
        f"{kind} {np.exp(generator.uniform(np.log(0.01), np.log(0.6))):.3f}"
        for kind in WIRE_FAULTS
        if generator.random() < 0.3
    )


def smaller_cases(case: SimulationCase) -> Iterator[SimulationCase]:
    """Yield cases that can run and have less in them."""
    for scenario in shrinking.smaller_networks(case.scenario):
        yield msgspec.structs.replace(case, scenario=scenario)
    for wire in shrinking.fewer(case.wire):
        yield msgspec.structs.replace(case, wire=wire)


def replay_command(case: SimulationCase) -> str:
    """Return the command that repeats a case exactly."""
    said: dict[str, Any] = {}
    while case != (drawn := draw_case(case.seed, said)):
        # A given field may change the fields that are drawn after it.
        there = drawn.fields
        said |= {name: one for name, one in case.fields.items() if one != there.get(name)}
    words = ["python", "-m", "tests.laboratory", "drawn", "--seeds", str(case.seed)]
    for name, value in said.items():
        words += ["--" + name.replace("_", "-"), _written(value)]
    return shlex.join(words)


def run_command(case: SimulationCase) -> str:
    """Return the command that runs and records the scenario of a case, in any driver.

    The command leaves out the faults of the wire, which only the laboratory can produce.
    """
    scenario = case.scenario
    return shlex.join(["concord", "run", "--scenario", scenario.name, *in_options(scenario)])


def _written(value: object) -> str:
    """A value as the options of the command read it."""
    if isinstance(value, tuple):
        return ", ".join(value)
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()
