"""When things are due in a network that runs in real time."""

import math

import msgspec

# An estimate is waited for as long as it takes to see that a process hangs, and no longer.
_ESTIMATE_TIMEOUT_S = 2.5


class Tempo(msgspec.Struct, frozen=True):
    """The timetable that every process keeps by itself, in seconds since the common start.

    Attributes:
        stretch: how many times longer a communication cycle lasts on the clock than on the bus.
        cycle_s: its length on the clock.
        step_s: from one sampling instant to the next, on the clock.
    """

    stretch: float
    cycle_s: float
    step_s: float

    @property
    def timeout_steps(self) -> int:
        """Steps after which an estimate that has not come counts as lost."""
        return 1 + math.ceil(_ESTIMATE_TIMEOUT_S / self.step_s)

    @property
    def oldest_s(self) -> float:
        """The age at which an estimate counts as lost: no node sends an older one."""
        return self.timeout_steps * self.step_s

    def step_begins_s(self, step: int) -> float:
        """The sampling instant of a step."""
        return step * self.step_s

    def cycle_begins_s(self, step: int, cycle: int) -> float:
        """Where a cycle of a step begins; `cycle` counts from the step's first one, 0."""
        return self.step_begins_s(step) + cycle * self.cycle_s

    def group_ends_s(self, step: int, cycle: int, group: int, groups: int) -> float:
        """The deadline of a group of a cycle; all groups last equally long."""
        return self.cycle_begins_s(step, cycle) + (group + 1) / groups * self.cycle_s
