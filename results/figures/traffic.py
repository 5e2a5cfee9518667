"""Traffic of runs: bytes, load of the bus, energy, and the ages of shares behind estimates."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.filters.metrics import largest_of_known, mean_of_known
from concord.results.records.runs import Runs
from concord.runtime.batched.build import changes_of
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.catalogue import definition_of

ELECTRONICS_NJ_PER_BIT = 50.0
AMPLIFIER_NJ_PER_BIT_M2 = 0.1


def energy_per_bit_nj(
    neighbours: Sequence[Sequence[int]], positions_m: np.ndarray | None
) -> np.ndarray:
    """Per node (N,), what a bit of its costs sender and hearers together, in nJ.

    `neighbours` says whom each node hears; `positions_m` (N, 2), or None for a wire.
    """
    nodes = len(neighbours)
    hearers = np.zeros(nodes)
    reach_m = np.zeros(nodes)
    for node, heard in enumerate(neighbours):
        for sender in heard:
            hearers[sender] += 1
            if positions_m is not None:
                distance_m = float(np.linalg.norm(positions_m[node] - positions_m[sender]))
                reach_m[sender] = max(reach_m[sender], distance_m)
    return ELECTRONICS_NJ_PER_BIT * (1 + hearers) + AMPLIFIER_NJ_PER_BIT_M2 * reach_m**2


def traffic_of(runs: Runs) -> dict[str, np.ndarray]:
    """Return the figures (R,) by name; those of a bus with time are NaN on one without, and where
    its settings changed in the run."""
    setup, payload, ages = runs.setup, runs.payload_bytes, runs.ages
    assert ages is not None, "keep the ages"
    arrays = (payload, runs.classes, ages)
    if len(runs.runs) > 1 and all((array == array[:1]).all() for array in arrays):
        # Without contention and losses, all runs have the traffic of the first.
        of_one = traffic_of(runs.of(slice(0, 1)))
        return {name: np.repeat(value, len(runs.runs)) for name, value in of_one.items()}
    plant = definition_of(setup.scenario).plant(setup.scenario)
    energy_nj = energy_per_bit_nj(setup.neighbours, plant.positions(0))
    heard = ages.reshape(len(payload), -1)
    known = np.where(heard < 0, np.nan, heard)
    on_bus = _on_bus(runs, ages)
    sent = on_bus.wire_bytes
    whole = payload > 0 if runs.cut is None else (payload > 0) & ~runs.cut
    return {
        "published": whole.sum(axis=(1, 2, 3)) / (_cycles(runs) * payload.shape[-1]),
        "bytes_per_step": sent.sum(axis=2).mean(axis=1),
        "energy_per_step": (8 * sent * energy_nj).sum(axis=2).mean(axis=1) * 1e-6,
        **on_bus.figures,
        "share_age": mean_of_known(known, (1,)),
        "share_age_max": largest_of_known(known),
        "never_heard": (heard < 0).mean(axis=1) if heard.shape[1] else np.zeros(len(payload)),
    }


def _cycles(runs: Runs) -> int:
    """Communication cycles of a run."""
    if runs.history is not None:
        rounds_from = [(epoch.first_step, epoch.rounds) for epoch in runs.history.epochs]
    else:
        usual = runs.setup.scenario.rounds
        rounds_from = [
            (change.step, int(change.standing.settings.get("rounds", usual)))
            for change in changes_of(runs.setup)
        ]
    begun = [one for one in rounds_from if one[0] < runs.steps]
    ends = [*(step for step, _ in begun[1:]), runs.steps]
    return sum((end - step) * rounds for (step, rounds), end in zip(begun, ends, strict=True))


class _OnBus(NamedTuple):
    """`wire_bytes` (R, S, N) of all frames with headers and padding; figures (R,) by name."""

    wire_bytes: np.ndarray
    figures: dict[str, np.ndarray]


def _on_bus(runs: Runs, ages: np.ndarray) -> _OnBus:
    setup, payload, classes = runs.setup, runs.payload_bytes, runs.classes
    bus = build_bus(setup)
    count, steps, rounds, nodes = payload.shape
    changed = any(change.anew for change in changes_of(setup))
    if not bus.has_time or changed or (runs.history is not None and not runs.history.one_bus):
        names = ("bus_load", "bus_load_all", "bus_time_us", "delay_us", "share_age_all")
        form = frame_format(setup.scenario)
        frames = np.ceil(payload / form.payload_limit_bytes)
        sent = (payload + form.overhead_bytes * frames).sum(axis=2)
        return _OnBus(sent, dict.fromkeys(names, np.full(count, np.nan)))
    cycles = np.arange(steps * rounds) % bus.schedule.period
    both = (one.reshape(-1, nodes) for one in (payload, classes))
    largest = max(int(one.max(initial=0)) for one in (cycles, payload, classes))
    # Narrow rows are compared faster; no entry is negative.
    kind = np.int16 if largest < 2**15 else np.int64
    rows = np.column_stack([one.astype(kind) for one in (np.tile(cycles, count), *both)])
    # The same frames in the same cycle of the schedule take the same time.
    kinds, which = _distinct(rows)
    load, delay_us = np.empty(len(kinds)), np.empty(len(kinds))
    wire_bytes, overhead_bytes = np.zeros((len(kinds), nodes)), bus.frame_format.overhead_bytes
    for number, (cycle, *sizes_and_classes) in enumerate(kinds.tolist()):
        frames = bus.transmissions(cycle, sizes_and_classes[:nodes], sizes_and_classes[nodes:])
        load[number] = bus.load(frames)
        delay_us[number] = bus.fusion_delay_us(rounds, frames)
        for frame in frames:
            wire_bytes[number, frame.node] += frame.payload_bytes + overhead_bytes
    shape = (count, steps, rounds)
    wait_us = np.array([bus.timebase.wait_us(step) for step in range(steps)])
    last = delay_us[which].reshape(shape)[:, :, -1] + wait_us
    mean_load = load[which].reshape(shape).mean(axis=(1, 2))
    passed = bus.timebase.ages_over_all(ages.reshape(count, steps, -1)).reshape(count, -1)
    return _OnBus(
        wire_bytes[which].reshape(*shape, nodes).sum(axis=2),
        {
            "bus_load": mean_load,
            "bus_load_all": mean_load * steps * rounds / bus.timebase.cycles_of(steps),
            "bus_time_us": mean_load * bus.cycle_us * rounds,
            "delay_us": last.mean(axis=1),
            "share_age_all": mean_of_known(np.where(passed < 0, np.nan, passed), (1,)),
        },
    )


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct rows (K, c) of (rows, c), and which of them each row is (rows,)."""
    # Sorting the rows takes a hundred times as long.
    rows = np.ascontiguousarray(rows)
    whole = rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel().tolist()
    places: dict[bytes, int] = {}
    which = np.array([places.setdefault(row, len(places)) for row in whole])
    return np.frombuffer(b"".join(places), rows.dtype).reshape(-1, rows.shape[1]), which
