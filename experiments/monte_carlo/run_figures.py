"""The figures of a Monte Carlo, run by run: errors, consistency, agreement, traffic.

Runs are the only thing here that is independent, so nothing is averaged over them: whoever wants an
interval needs them one by one.
"""

import numpy as np
from scipy.special import chdtri

from concord.experiments.monte_carlo.energy import energy_per_bit_nj
from concord.experiments.monte_carlo.run_frame import RunFrame
from concord.experiments.monte_carlo.simulate import Histories
from concord.experiments.monte_carlo.smoothed_errors import smoothed_errors
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import symmetrise
from concord.filters.metrics import largest_of_known, mean_of_known, rmse
from concord.runtime.batched.build import changes_of
from concord.scenarios.build import build_bus
from concord.scenarios.bus_plan import frame_format
from concord.scenarios.catalogue import definition_of, scored_nees
from concord.scenarios.rules import is_set_valued
from concord.scenarios.scenario_definition import Score
from concord.scenarios.setup import Setup

COVERED = 0.95


def figures_of(setup: Setup, histories: Histories, frame: RunFrame) -> dict[str, np.ndarray]:
    """Return the variables of `figure_table.FIGURES`, with their dimensions."""
    score = definition_of(setup.scenario).score
    readings, _ = kept(histories)
    counted = scored_steps(score, readings)
    errors = histories.mean - histories.truth[:, :, None]
    central = frame.mean - histories.truth
    states = list(score.states)
    # Steps that do not count are left out, as if the truth were unknown.
    scored = np.where(counted[..., None, None], errors, np.nan)
    spread = histories.mean - _average(histories.mean)
    position = scored[..., states]
    read = np.logical_not(np.isnan(readings).all(axis=(-1, -2)))
    per_node = rmse(position, (1,))
    figures = {
        "rmse": rmse(position, (1, 2)),
        "rmse_centralised": rmse(np.where(counted[..., None], central, np.nan)[..., states], (1,)),
        "rmse_blind": rmse(np.where(read[..., None], np.nan, position), (1, 2)),
        "rmse_worst_node": largest_of_known(per_node),
        "disagreement": rmse(
            np.where(counted[..., None, None], spread, np.nan)[..., states], (1, 2)
        ),
        "rmse_state": np.sqrt(mean_of_known(scored**2, (1, 2))),
        "rmse_node": per_node,
        "error": rmse(errors[..., states], (2,)),
        "error_centralised": rmse(central[..., None, states], (2,)),
        "spread": rmse(spread[..., states], (2,)),
        "bound": np.sqrt(np.trace(_part(frame.bound, states), axis1=-2, axis2=-1)),
        "bound_state": np.sqrt(np.diagonal(frame.bound, axis1=-2, axis2=-1)),
    }
    figures |= _smoothed(setup, histories, frame, counted)
    figures |= _consistency(setup, histories.nees, counted)
    figures["anees_centralised"] = _anees_central(setup, central, frame.cov, counted)
    return figures | traffic_of(setup, histories)


def _smoothed(
    setup: Setup, histories: Histories, frame: RunFrame, counted: np.ndarray
) -> dict[str, np.ndarray]:
    if histories.past is None:
        nothing = np.full(len(histories.runs), np.nan)
        return {"rmse_smoothed": nothing, "rmse_smoothed_centralised": nothing}
    central, known = Gaussian(frame.mean, frame.cov), (histories.truth, histories.control)
    network, best = smoothed_errors(setup, histories.past, central, *known, counted)
    return {"rmse_smoothed": network[:, -1], "rmse_smoothed_centralised": best[:, -1]}


def kept(histories: Histories) -> tuple[np.ndarray, np.ndarray]:
    """Readings and ages, which every figure of a network needs."""
    assert histories.readings is not None and histories.ages is not None, "keep both"
    return histories.readings, histories.ages


def scored_steps(score: Score, readings: np.ndarray) -> np.ndarray:
    """Which steps (R, steps) count: from the scenario's on, but not before the first reading."""
    steps = readings.shape[1]
    seen = np.logical_not(np.isnan(readings).all(axis=(-1, -2, -3)))
    # The first True; 0 where there is none.
    first_seen = seen.argmax(axis=1)
    first = np.minimum(np.maximum(score.first_step, first_seen), steps - 1)
    return np.arange(steps) >= first[:, None]


def _consistency(setup: Setup, values: np.ndarray, counted: np.ndarray) -> dict[str, np.ndarray]:
    states = definition_of(setup.scenario).score.nees_states
    if is_set_valued(setup.scenario):
        nothing = np.full(len(values), np.nan)
        return {"anees": nothing, "coverage": nothing, "nees": np.full(counted.shape, np.nan)}
    within = np.where(np.isnan(values), np.nan, values <= chdtri(len(states), 1 - COVERED))
    here = counted[..., None]
    return {
        "anees": mean_of_known(np.where(here, values, np.nan), (1, 2)) / len(states),
        "coverage": mean_of_known(np.where(here, within, np.nan), (1, 2)),
        "nees": mean_of_known(values, (2,)) / len(states),
    }


def _anees_central(
    setup: Setup, errors: np.ndarray, cov: np.ndarray, counted: np.ndarray
) -> np.ndarray:
    if is_set_valued(setup.scenario):
        return np.full(len(errors), np.nan)
    states = list(definition_of(setup.scenario).score.nees_states)
    values = scored_nees(setup.scenario, errors, symmetrise(cov))
    return mean_of_known(np.where(counted, values, np.nan), (1,)) / len(states)


def traffic_of(setup: Setup, histories: Histories) -> dict[str, np.ndarray]:
    """Return the traffic per node, its load on bus and batteries, and the ages of the shares."""
    payload, form = histories.payload_bytes, frame_format(setup.scenario)
    frames = np.ceil(payload / form.payload_limit_bytes)
    sent = (payload + form.overhead_bytes * frames).sum(axis=2)
    plant = definition_of(setup.scenario).plant(setup.scenario)
    energy_nj = energy_per_bit_nj(setup.neighbours, plant.positions(0))
    ages = kept(histories)[1]
    heard = ages.reshape(len(payload), -1)
    on_bus = _bus(setup, payload, histories.classes, ages)
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


def _part(cov: np.ndarray, states: list[int]) -> np.ndarray:
    return cov[..., states, :][..., states]


def _average(mean: np.ndarray) -> np.ndarray:
    """Return the average of the nodes that believe something, over axis 2, kept."""
    return mean_of_known(mean, (2,))[:, :, None]
