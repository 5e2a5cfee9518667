"""How fast a network runs in real time: the bus of a scenario, stretched to what processes hold."""

import math

from concord.nodes.commands import TimelyCommand
from concord.nodes.tempo import Tempo
from concord.scenarios.build import build_bus, build_controller
from concord.scenarios.scenario import require
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import stretch_of

# Processes that share a machine keep such times; a cycle on the bus is some ten times shorter.
SHORTEST_PART_S = 0.02
# Longer cycles lose no fewer frames, and make estimates older.
LONGEST_CYCLE_S = 0.1


def tempo_of(setup: Setup, stretch: float | None) -> Tempo:
    """The timetable of a setup in real time.

    Sampling instants keep the plant's time where the stretched cycles of a step fit between them,
    and otherwise follow when these are over.

    Args:
        setup: the network.
        stretch: how many times longer a cycle lasts than on the bus. None is the longest cycle that
            the step allows, of 100 ms at most; what is sent at once has 20 ms or more.

    Raises:
        ValueError: the scenario has no time to be kept, or cannot be run against the clock.
    """
    scenario = setup.scenario
    bus = build_bus(setup)
    if not bus.has_time:
        raise ValueError(
            f"--driver realtime --bus {scenario.bus.name}: a bus without time sets no pace; "
            "use --bus flexray, or --driver processes"
        )
    for step, command in script_of(scenario):
        if not isinstance(command, TimelyCommand):
            raise ValueError(
                f"--driver realtime --changes: set at step {step} waits until all have ended a "
                "step, and time does not; leave it out, or use --driver processes"
            )
    controller = build_controller(scenario)
    if controller is not None and controller.node is not None:
        raise ValueError(
            f"--driver realtime --control {controller.node}: the plant would wait for a node's "
            "estimate; use --control truth, or --driver processes"
        )
    if stretch is None:
        parts = max(len(bus.schedule.groups(cycle)) for cycle in range(bus.schedule.period))
        allowed_s = setup.time_step_s * stretch_of(scenario.bus) / scenario.rounds
        cycle_s = max(parts * SHORTEST_PART_S, min(allowed_s, LONGEST_CYCLE_S))
        stretch = max(1.0, cycle_s / (bus.cycle_us * 1e-6))
    require(1 <= stretch < math.inf, "cycle-stretch", stretch, "at least 1, and finite")
    cycle_s = bus.cycle_us * 1e-6 * stretch
    step_s = max(setup.time_step_s * stretch_of(scenario.bus), scenario.rounds * cycle_s)
    return Tempo(stretch, cycle_s, step_s)
