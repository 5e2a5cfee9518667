"""The timetable of a node in real time, on the clock of its process."""

import time

from concord.nodes.node_state import NodeConfig, NodeState
from concord.nodes.tempo import Tempo


class NodeTimetable:
    """Times of steps and groups since the common start; `start_s` is 0 until that is known."""

    def __init__(self, tempo: Tempo) -> None:
        self.tempo, self.start_s = tempo, 0.0

    def now_s(self) -> float:
        """Return the time since the common start."""
        return time.monotonic() - self.start_s

    def late_s(self, step: int, cycle: int = 0) -> float:
        """Return how long ago a cycle of a step began; `cycle` counts from 0 in each step."""
        return self.now_s() - self.tempo.cycle_begins_s(step, cycle)

    def left_s(self, config: NodeConfig, state: NodeState) -> float:
        """Return the time until the open group of the cycle ends."""
        groups = len(config.schedule.groups(state.cycle))
        cycle = (state.cycle - config.first_cycle) % config.rounds
        return self.tempo.group_ends_s(state.step, cycle, state.group, groups) - self.now_s()

    def is_far_behind(self, step: int) -> bool:
        """Whether the estimate of a step that only begins would count as lost."""
        return self.late_s(step) > self.tempo.oldest_s
