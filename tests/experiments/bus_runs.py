"""Small runs in memory, with what the bus tests want to know of them."""

from typing import NamedTuple

from experiments.drivers import in_memory
from experiments.options import ScenarioOptions
from experiments.trace import Trace, read_trace
from scenarios.build import build_plan
from scenarios.bus_plan import BusPlan
from scenarios.setup import Setup, prepare


class Run(NamedTuple):
    setup: Setup
    trace: Trace
    messages: list[tuple[str, bytes]]

    @property
    def plan(self) -> BusPlan:
        return build_plan(self.setup)


def run(**options) -> Run:
    options = {"scenario": "oscillator", "graph": "ring", "nodes": 5, "steps": 3, **options}
    setup = prepare(ScenarioOptions(**options).resolve())
    messages = in_memory(setup)
    return Run(setup, read_trace(setup, messages), messages)
