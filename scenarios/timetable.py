"""Which frame is where in a communication cycle, from what each node sends in it."""

from collections.abc import Callable, Sequence

import numpy as np

from bus.timing import Transmission, dynamic_transmissions, static_transmissions
from scenarios.bus_plan import BusPlan

Cycles = list[tuple[Transmission, ...]]
Placement = Callable[[int, Sequence[int]], tuple[Transmission, ...]]


def placement(plan: BusPlan) -> Placement:
    """(cycle, payload bytes of each node) -> the frames of that cycle, on a bus with time.

    The bytes are those of all frames of a node together, 0 where it is silent: owners of static
    slots send in these, as many as it takes, and everybody else in the dynamic segment.
    """
    assert plan.cluster is not None and plan.table is not None, "a bus without time"
    cluster, schedule, table = plan.cluster, plan.schedule, plan.table
    owned = [
        static_transmissions(cluster, table.static_slots(row))
        for row in range(len(schedule.static_table))
    ]
    contenders = {node for row in schedule.contender_table for node in row}
    requests = {node: table.request(node, 0) for node in contenders}

    def place(cycle: int, sizes: Sequence[int]) -> tuple[Transmission, ...]:
        static = _filled(owned[cycle % len(owned)], sizes)
        winners = [
            requests[node]._replace(payload_bytes=size)
            for node, size in enumerate(sizes)
            if size and node not in schedule.static_senders(cycle)
        ]
        return (*static, *dynamic_transmissions(cluster, winners))

    return place


def timetable(plan: BusPlan, payload_bytes: np.ndarray) -> Cycles:
    """The frames of every cycle, in order of time, on a bus with time.

    `payload_bytes` (..., N): one row per cycle from cycle 0 on, as `placement` takes it.
    """
    place = placement(plan)
    rows = payload_bytes.reshape(-1, plan.schedule.nodes).tolist()
    return [place(cycle, sizes) for cycle, sizes in enumerate(rows)]


def _filled(owned: Sequence[Transmission], sizes: Sequence[int]) -> list[Transmission]:
    """The static frames that are sent: of each owner the first ones, up to its payload."""
    left = list(sizes)
    sent: list[Transmission] = []
    for frame in owned:
        if left[frame.node] > 0:
            left[frame.node] -= frame.payload_bytes
            sent.append(frame)
    return sent
