"""Communication cycles as they are drawn: which frame lay where, and which owner was silent."""

from collections.abc import Mapping

from concord.bus.bus import Bus, Transmission
from concord.dashboard.frames.frame import BusCycle


class BusView:
    """Places the frames of a cycle on the bus of a run."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def cycle(self, cycle: int, sizes: Mapping[int, int], frame_ids: Mapping[int, int]) -> BusCycle:
        """A cycle in which each node sent so many payload bytes, all its frames together, of which
        one had this ID."""
        schedule = self._bus.schedule
        row = [sizes.get(node, 0) for node in range(schedule.nodes)]
        classes = [
            self._bus.urgency_class(node, cycle, frame_ids.get(node, 0))
            for node in range(schedule.nodes)
        ]
        frames = self._bus.transmissions(cycle, row, classes)
        silent = tuple(node for node in schedule.static_senders(cycle) if not row[node])
        number = self._bus.timebase.bus_cycle(cycle)
        return BusCycle(
            self._bus, cycle, number, tuple(sorted(frames, key=_when)), silent, sum(row)
        )


def _when(frame: Transmission) -> tuple[float, int]:
    return frame.start_us, frame.frame_id
