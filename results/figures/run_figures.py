"""The figures of a Monte Carlo, run by run: errors, consistency, agreement, traffic.

Runs are the only thing here that is independent, so nothing is averaged over them: whoever wants an
interval needs them one by one.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import largest_of_known, mean_of_known
from concord.results.figures.figure_table import OF_FEATURES
from concord.results.figures.network_errors import (
    NetworkErrors,
    RunTruths,
    network_errors,
    scored_steps,
    where_counted,
)
from concord.results.figures.run_frame import RunFrame
from concord.results.figures.smoothed_errors import smoothed_errors
from concord.results.records.extras import run_extras
from concord.results.records.histories import Histories
from concord.runtime.batched.build import changes_of
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.catalogue import definition_of
from concord.scenarios.setup import Setup

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


COVERED = 0.95


def figures_of(setup: Setup, histories: Histories, frame: RunFrame) -> dict[str, np.ndarray]:
    """Return the variables of `figure_table.FIGURES`, with their dimensions."""
    score = definition_of(setup.scenario).score
    states = list(score.states)
    readings, _ = kept(histories)
    counted = scored_steps(score, readings)
    scored = _Scored(min(score.first_step, counted.shape[1] - 1), counted)
    central = Gaussian(frame.mean, frame.cov)
    known = RunTruths(histories.truth, readings, histories.extras)
    errors = network_errors(setup, known, histories.mean, histories.nees, central)
    # Squared lengths in the scored states.
    lengths, central_lengths, spreads = ((part**2).sum(-1) for part in errors[:3])
    squares = (histories.mean - histories.truth[:, :, None]) ** 2
    blind = np.isnan(readings).all(axis=(-1, -2))
    per_node = _root(scored.of(lengths), (1,))
    figures = {
        "rmse": _root(scored.of(lengths), (1, 2)),
        "rmse_centralised": _root(scored.of(central_lengths), (1,)),
        "rmse_blind": _root(scored.of(np.where(blind, lengths, np.nan)), (1, 2)),
        "rmse_worst_node": largest_of_known(per_node),
        "disagreement": _root(scored.of(spreads), (1, 2)),
        "rmse_state": _root(scored.of(squares), (1, 2)),
        "rmse_node": per_node,
        "error": _root(lengths, (2,)),
        "error_centralised": np.sqrt(central_lengths),
        "spread": _root(spreads, (2,)),
        "bound": np.sqrt(np.trace(frame.bound[..., states, :][..., states], axis1=-2, axis2=-1)),
        "bound_state": np.sqrt(np.diagonal(frame.bound, axis1=-2, axis2=-1)),
    }
    figures |= _smoothed(setup, histories, frame, counted)
    figures |= dict.fromkeys(OF_FEATURES, np.full(len(readings), np.nan))
    if (extras := run_extras(setup.scenario)) is not None:
        figures |= extras.figures_of_runs(setup, histories.extras, readings)
    figures |= _consistency(errors, scored, len(score.nees_states))
    return figures | traffic_of(setup, histories)


def _smoothed(
    setup: Setup, histories: Histories, frame: RunFrame, counted: np.ndarray
) -> dict[str, np.ndarray]:
    if histories.past is None:
        nothing = np.full(len(histories.runs), np.nan)
        return {"rmse_smoothed": nothing, "rmse_smoothed_centralised": nothing}
    known = Gaussian(frame.mean, frame.cov), histories.truth, histories.control
    network, best = smoothed_errors(setup, histories.past, *known, counted)
    return {"rmse_smoothed": network[:, -1], "rmse_smoothed_centralised": best[:, -1]}


def kept(histories: Histories) -> tuple[np.ndarray, np.ndarray]:
    """Readings and ages, which every figure of a network needs."""
    assert histories.readings is not None and histories.ages is not None, "keep both"
    return histories.readings, histories.ages


class _Scored(NamedTuple):
    """Steps of R runs that count, `counted` (R, steps); none of them is before step `first`."""

    first: int
    counted: np.ndarray

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return values (R, steps, ...) from `first` on, NaN in the steps that do not count."""
        values, counted = values[:, self.first :], self.counted[:, self.first :]
        if counted.all():
            return values
        return where_counted(counted, values)


def _root(squares: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Root of the mean of squares over axes; unknown ones are left out."""
    return np.sqrt(mean_of_known(squares, axes))


def _consistency(errors: NetworkErrors, scored: _Scored, states: int) -> dict[str, np.ndarray]:
    counted = scored.of(errors.nees)
    most = chdtri(states, 1 - COVERED) / states
    within = np.where(np.isnan(counted), np.nan, counted <= most)
    return {
        "anees": mean_of_known(counted, (1, 2)),
        "coverage": mean_of_known(within, (1, 2)),
        "nees": mean_of_known(errors.nees, (2,)),
        "anees_centralised": mean_of_known(scored.of(errors.nees_centre), (1,)),
    }


def traffic_of(setup: Setup, histories: Histories) -> dict[str, np.ndarray]:
    """Return the traffic per node, its load on bus and batteries, and the ages of the shares."""
    arrays = (histories.payload_bytes, histories.classes, kept(histories)[1])
    if not all((array == array[:1]).all() for array in arrays):
        return _traffic(setup, *arrays)
    # Without contention and losses, all runs have the traffic of the first.
    of_one = _traffic(setup, *(array[:1] for array in arrays))
    return {name: np.repeat(value, len(histories.runs)) for name, value in of_one.items()}


def _traffic(
    setup: Setup, payload: np.ndarray, classes: np.ndarray, ages: np.ndarray
) -> dict[str, np.ndarray]:
    form = frame_format(setup.scenario)
    frames = np.ceil(payload / form.payload_limit_bytes)
    sent = (payload + form.overhead_bytes * frames).sum(axis=2)
    plant = definition_of(setup.scenario).plant(setup.scenario)
    energy_nj = energy_per_bit_nj(setup.neighbours, plant.positions(0))
    heard = ages.reshape(len(payload), -1)
    on_bus = _bus(setup, payload, classes, ages)
    return {
        "published": (payload > 0).sum(axis=(1, 2, 3)) / (_cycles(setup) * payload.shape[-1]),
        "bytes_per_step": sent.sum(axis=2).mean(axis=1),
        "energy_per_step": (8 * sent * energy_nj).sum(axis=2).mean(axis=1) * 1e-6,
        **on_bus,
        "share_age": mean_of_known(np.where(heard < 0, np.nan, heard), (1,)),
        "share_age_max": largest_of_known(np.where(heard < 0, np.nan, heard)),
        "never_heard": (heard < 0).mean(axis=1) if heard.shape[1] else np.zeros(len(payload)),
    }


def _cycles(setup: Setup) -> int:
    """Communication cycles of a run."""
    steps, changes = setup.scenario.steps, changes_of(setup)
    ends = [*(change.step for change in changes[1:]), steps]
    return sum(
        (end - change.step) * int(change.standing.settings.get("rounds", setup.scenario.rounds))
        for change, end in zip(changes, ends, strict=True)
    )


def _bus(
    setup: Setup, payload: np.ndarray, classes: np.ndarray, ages: np.ndarray
) -> dict[str, np.ndarray]:
    """Figures of a bus with time (R,); NaN on a bus without, or of several settings."""
    bus = build_bus(setup)
    runs, steps, rounds, nodes = payload.shape
    if not bus.has_time or any(change.anew for change in changes_of(setup)):
        names = ("bus_load", "bus_load_all", "bus_time_us", "delay_us", "share_age_all")
        return dict.fromkeys(names, np.full(runs, np.nan))
    cycles = np.arange(steps * rounds) % bus.schedule.period
    sent = (one.reshape(-1, nodes) for one in (payload, classes))
    largest = max(int(one.max(initial=0)) for one in (cycles, payload, classes))
    # Narrow rows are compared faster; no entry is negative.
    kind = np.int16 if largest < 2**15 else np.int64
    rows = np.column_stack([one.astype(kind) for one in (np.tile(cycles, runs), *sent)])
    # The same frames in the same cycle of the schedule take the same time.
    kinds, which = _distinct(rows)
    load, delay_us = np.empty(len(kinds)), np.empty(len(kinds))
    for number, (cycle, *sizes_and_classes) in enumerate(kinds.tolist()):
        frames = bus.transmissions(cycle, sizes_and_classes[:nodes], sizes_and_classes[nodes:])
        load[number] = bus.load(frames)
        delay_us[number] = bus.fusion_delay_us(rounds, frames)
    shape = (runs, steps, rounds)
    wait_us = np.array([bus.timebase.wait_us(step) for step in range(steps)])
    last = delay_us[which].reshape(shape)[:, :, -1] + wait_us
    mean_load = load[which].reshape(shape).mean(axis=(1, 2))
    passed = bus.timebase.ages_over_all(ages.reshape(runs, steps, -1)).reshape(runs, -1)
    return {
        "bus_load": mean_load,
        "bus_load_all": mean_load * steps * rounds / bus.timebase.cycles_of(steps),
        "bus_time_us": mean_load * bus.cycle_us * rounds,
        "delay_us": last.mean(axis=1),
        "share_age_all": mean_of_known(np.where(passed < 0, np.nan, passed), (1,)),
    }


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct rows (K, c) of (rows, c), and which of them each row is (rows,)."""
    # Sorting the rows takes a hundred times as long.
    rows = np.ascontiguousarray(rows)
    whole = rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel().tolist()
    places: dict[bytes, int] = {}
    which = np.array([places.setdefault(row, len(places)) for row in whole])
    return np.frombuffer(b"".join(places), rows.dtype).reshape(-1, rows.shape[1]), which
