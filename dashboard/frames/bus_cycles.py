"""Communication cycles as they are drawn: which frame lay where, and which owner was silent."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from concord.bus.bus import Bus, Transmission
from concord.dashboard.frames.frame import BusCycle, LogEntry


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


def judged(
    cycles: Sequence[BusCycle],
    heard: np.ndarray,
    ages: np.ndarray,
    alive: np.ndarray,
    events: Iterable[LogEntry],
) -> tuple[BusCycle, ...]:
    """Return the cycles of a step with the frames that were missed and rejected.

    heard (H, 2): receiver and sender; ages (H,) of what the receiver holds after the step, in
    cycles, -1 of nothing; alive (N,): the nodes that take part.
    """
    receiver, sender = heard.T
    held = np.where(ages >= 0, cycles[-1].cycle - ages, -1)
    told: list[BusCycle] = []
    for cycle in cycles:
        sent = np.zeros(len(alive), dtype=bool)
        sent[[frame.node for frame in cycle.frames]] = True
        missed = sent[sender] & alive[receiver] & (held < cycle.cycle)
        told.append(cycle._replace(missed=tuple(np.unique(sender[missed]).tolist())))
    rejected = tuple(event.text for event in events if "rejected" in event.text)
    return (*told[:-1], told[-1]._replace(rejected=rejected))
