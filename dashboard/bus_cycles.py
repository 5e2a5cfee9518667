"""Communication cycles as they are drawn: which frame lay where, and which owner was silent."""

from collections.abc import Mapping

from bus.timing import Transmission
from dashboard.frame import BusCycle
from scenarios.bus_plan import BusPlan
from scenarios.timetable import placement


class BusView:
    """Places the frames of a cycle on the bus of a run."""

    def __init__(self, plan: BusPlan) -> None:
        self._plan = plan
        self._place = None if plan.cluster is None else placement(plan)

    def cycle(self, cycle: int, sizes: Mapping[int, int]) -> BusCycle:
        """A cycle in which each node sent so many payload bytes, all its frames together."""
        schedule = self._plan.schedule
        row = [sizes.get(node, 0) for node in range(schedule.nodes)]
        frames = self._slots(cycle, row) if self._place is None else self._place(cycle, row)
        silent = tuple(node for node in schedule.static_senders(cycle) if not row[node])
        return BusCycle(cycle, tuple(sorted(frames, key=_when)), silent, sum(row))

    def _slots(self, cycle: int, row: list[int]) -> tuple[Transmission, ...]:
        """On a bus without time each share takes one place after the other."""
        return tuple(
            Transmission(node, place + 1, "A", "static", row[node], float(place), place + 1.0)
            for place, node in enumerate(self._plan.schedule.static_senders(cycle))
            if row[node]
        )


def _when(frame: Transmission) -> tuple[float, int]:
    return frame.start_us, frame.frame_id
