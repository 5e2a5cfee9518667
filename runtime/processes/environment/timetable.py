"""The timetable of the environment process in real time."""

from collections.abc import Iterator
from typing import NamedTuple

from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.messages import BidsClosed, StepClosed
from concord.nodes.tempo import Tempo


class Beat(NamedTuple):
    """The time has come for a step."""


def timetable(
    tempo: Tempo, config: EnvironmentConfig
) -> Iterator[tuple[float, Beat | BidsClosed | StepClosed]]:
    """Seconds after the common start, ascending, and what is due then.

    A step begins at its sampling instant. Bids end in the middle of their group, so that winners
    have the other half to send. A step is closed some steps later.
    """
    timeout_steps = tempo.timeout_steps
    for step in range(config.steps + timeout_steps):
        begins_s = tempo.step_begins_s(step)
        if step >= timeout_steps:
            yield begins_s, StepClosed(step - timeout_steps)
        if step >= config.steps:
            continue
        yield begins_s, Beat()
        for cycle in range(config.rounds):
            number = config.cycle_of(step) + cycle
            groups = config.schedule.groups(number)
            for number_in_cycle, group in enumerate(groups):
                if group.dynamic_slots:
                    middle_s = (number_in_cycle + 0.5) / len(groups) * tempo.cycle_s
                    at_s = tempo.cycle_begins_s(step, cycle) + middle_s
                    yield at_s, BidsClosed(number, number_in_cycle)
    yield tempo.step_begins_s(config.steps + timeout_steps), StepClosed(config.steps - 1)
