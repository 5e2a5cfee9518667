"""The timetable of a node in real time, on the clock of its process."""

from concord.nodes.node_state import NodeConfig, NodeState
from concord.nodes.tempo import Tempo


class NodeTimetable:
    """Times of steps and groups on the node's own clock, which shows `now_s`.

    `start_s` is the common start on that clock, 0 until it is known.
    """

    def __init__(self, tempo: Tempo) -> None:
        self.tempo, self.start_s = tempo, 0.0

    def late_s(self, now_s: float, step: int, cycle: int = 0) -> float:
        """Return how long ago a cycle of a step began; `cycle` counts from 0 in each step."""
        return now_s - self.start_s - self.tempo.cycle_begins_s(step, cycle)

    def group_ends_s(self, config: NodeConfig, state: NodeState) -> float:
        """Return the time at which the open group of the cycle ends."""
        groups = len(config.schedule.groups(state.cycle))
        cycle = (state.cycle - config.first_cycle) % config.rounds
        return self.start_s + self.tempo.group_ends_s(state.step, cycle, state.group, groups)

    def is_lost(self, now_s: float, step: int) -> bool:
        """Whether an estimate of a step that is sent now counts as lost."""
        return self.late_s(now_s, step) > self.tempo.oldest_s
