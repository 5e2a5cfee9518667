"""What the world does when in real time."""

import math
from collections.abc import Iterator
from typing import NamedTuple

from nodes.messages import BidsClosed, StepClosed
from nodes.tempo import Tempo
from nodes.world import WorldConfig

# An estimate is waited for as long as it takes to see that a process hangs, and no longer.
PATIENCE_S = 2.5


class Beat(NamedTuple):
    """The time has come for a step."""


def timetable(
    tempo: Tempo, config: WorldConfig
) -> Iterator[tuple[float, Beat | BidsClosed | StepClosed]]:
    """Seconds after the common start, ascending, and what is due then.

    A step begins at its sampling instant, bids end in the middle of their part of a cycle, so that
    the other half is left for who has won, and a step is over for good some steps later.
    """
    patience = 1 + math.ceil(PATIENCE_S / tempo.step_s)
    for step in range(config.steps + patience):
        begins_s = tempo.step_begins_s(step)
        if step >= patience:
            yield begins_s, StepClosed(step - patience)
        if step >= config.steps:
            continue
        yield begins_s, Beat()
        for cycle in range(config.rounds):
            number = config.cycle_of(step) + cycle
            groups = config.schedule.groups(number)
            for group, part in enumerate(groups):
                if part.dynamic_slots:
                    middle_s = (group + 0.5) / len(groups) * tempo.cycle_s
                    at_s = tempo.cycle_begins_s(step, cycle) + middle_s
                    yield at_s, BidsClosed(number, group)
    yield tempo.step_begins_s(config.steps + patience), StepClosed(config.steps - 1)
