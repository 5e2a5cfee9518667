"""Small runs in memory, with what the bus tests want to know of them."""

from typing import NamedTuple

from concord.bus.bus import Bus
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup


class Run(NamedTuple):
    setup: Setup
    trace: Trace
    messages: list[tuple[str, bytes]]

    @property
    def plan(self) -> Bus:
        return build_bus(self.setup)


def run(**options) -> Run:
    options = {"scenario": "oscillator", "graph": "ring", "nodes": 5, "steps": 3, **options}
    setup = prepare(scenario_of(**options))
    messages = in_memory(setup)
    return Run(setup, read_trace(setup, messages), messages)
