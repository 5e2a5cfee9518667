"""How well a node keeps its timetable, step by step."""

from dataclasses import dataclass, field

from concord.nodes.messages import Timing


@dataclass
class _Record:
    """One step that is under way, or will be."""

    heartbeat_late_s: float | None
    cycle_late_s: list[float] = field(default_factory=list)
    incomplete: int = 0
    overrun: int = 0


class TimingRecords:
    """Collects the delays of each step until its estimate is sent."""

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._steps: dict[int, _Record] = {}
        # The last cycle that lacked something: its groups count once.
        self._lacking = -1

    def hear_heartbeat(self, step: int, late_s: float | None) -> None:
        """The first heartbeat of a step came so late; None: the node goes on without one."""
        self._steps.setdefault(step, _Record(late_s))

    def begin_cycle(self, step: int, late_s: float) -> None:
        """A cycle of a step begins so long after its time."""
        record = self._steps[step]
        record.cycle_late_s.append(late_s)
        record.overrun += late_s >= self._cycle_s

    def end_group(self, step: int, cycle: int, is_complete: bool) -> None:
        """A group of a cycle ends at its deadline, with all that was due or without."""
        record = self._steps[step]
        in_time = record.cycle_late_s[-1] < self._cycle_s
        if in_time and not is_complete and self._lacking != cycle:
            self._lacking = cycle
            record.incomplete += 1

    def take(self, node: int, step: int) -> Timing:
        """Return the timing of a step that is over, and forget it."""
        record = self._steps.pop(step)
        return Timing(
            node,
            step,
            record.heartbeat_late_s,
            record.cycle_late_s,
            record.incomplete,
            record.overrun,
        )
