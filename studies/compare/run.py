"""The entries of a comparison are computed, and each finished one is kept at once."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from concord.nodes import node as state_machine
from concord.nodes.messages import NodeEvent
from concord.nodes.node_state import NodeConfig, NodeState
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import UserRule
from concord.studies.compare.entries import ComparedEntry
from concord.studies.sweep.pieces import compute, joined, pieces_of
from concord.studies.sweep.specification import Specification, cells_of
from concord.studies.sweep.store import load_arrays, save_arrays
from concord.studies.sweep.workers import Engine

_STEPS, _REPLAYS = 20, 9


def node_update_us(setup: Setup) -> float:
    """Return the microseconds that a step takes at the node with the most neighbours.

    A step is all that the node does in it: prediction, readings, frames in both directions,
    fusion. The first steps of the scenario are replayed without its changes; the fastest of nine
    replays counts, because other programs can only slow one down.
    """
    scenario = setup.scenario
    short = msgspec.structs.replace(scenario, steps=min(scenario.steps, _STEPS), changes=())
    setup = msgspec.structs.replace(setup, scenario=short)
    configs = [build_node(setup, node) for node in range(short.nodes)]
    busiest = max(configs, key=lambda config: len(config.neighbours))
    events: list[NodeEvent] = []

    def watch(config: NodeConfig, event: NodeEvent, _: NodeState) -> None:
        if config.index == busiest.index:
            events.append(event)

    in_process.run(build_environment(setup), configs, MemoryRecorder(), watch=watch)  # type: ignore[arg-type]
    return min(_replayed_ns(busiest, events) for _ in range(_REPLAYS)) / short.steps / 1e3


def _replayed_ns(config: NodeConfig, events: list[NodeEvent]) -> int:
    state = state_machine.initial_state(config)
    started = time.process_time_ns()
    for event in events:
        state, _ = state_machine.step(config, state, event)
    return time.process_time_ns() - started


KEPT, FILE = "kept", "figures"
# Figures of a sweep that a comparison needs, all of shape (runs,).
TAKEN = (
    "rmse", "rmse_centralised", "anees", "coverage", "bytes_per_step", "bus_time_us", "failed",
    "sets_outside",
)  # fmt: skip
Figures = dict[str, np.ndarray]


def kept_before(entries: Sequence[ComparedEntry], folder: Path | None) -> dict[int, Figures]:
    """Return the figures of entries that an earlier comparison has kept, by place."""
    if folder is None:
        return {}
    found = {
        place: load_arrays(folder / KEPT / entry.digest, FILE)
        for place, entry in enumerate(entries)
        if not entry.reason and entry.is_kept
    }
    return {place: figures for place, figures in found.items() if figures is not None}


def compute_missing(
    entries: Sequence[ComparedEntry],
    done: dict[int, Figures],
    folder: Path | None,
    engine: Engine,
    on_runs: Callable[[int], None],
) -> tuple[list[ComparedEntry], dict[int, Figures]]:
    """Return the entries and their figures by place, computed where they are not done.

    An own rule that fails in a run gets the reason. `on_runs` is called with the number of runs
    that are complete. Ctrl-C ends the work, and the next call finds what was kept.
    """
    entries, figures = list(entries), dict(done)
    missing = [n for n, one in enumerate(entries) if not one.reason and n not in done]
    runs = 0
    if missing:
        on_runs(runs)
    for number, result in engine(entry_figures, [entries[n].specification for n in missing]):
        place = missing[number]
        if isinstance(result, str):
            entries[place] = entries[place]._replace(reason=result)
        else:
            figures[place] = result
            if folder is not None and entries[place].is_kept:
                target = folder / KEPT / entries[place].digest
                target.mkdir(parents=True, exist_ok=True)
                save_arrays(target, FILE, result)
        runs += entries[place].case.runs
        on_runs(runs)
    return entries, figures


def entry_figures(specification: Specification) -> Figures | str:
    """Return the figures of one rule on one case, or why a rule of the user fails there."""
    (cell,) = cells_of(specification)
    if not isinstance(cell.scenario.rule, UserRule):
        return _figures(specification)
    try:
        return _figures(specification)
    # Code of the user may fail in any way; the other rules go on.
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def _figures(specification: Specification) -> Figures:
    (cell,) = cells_of(specification)
    whole = joined([compute(piece) for piece in pieces_of(specification, [cell])])
    setup = prepare(cell.scenario)
    figures = {name: whole[name] for name in TAKEN}
    if is_set_valued(setup.scenario):
        # A set's own centre is its reference; the comparison has one for all rules of a case.
        figures["rmse_centralised"] = np.full_like(figures["rmse"], np.nan)
    figures["node_us"] = np.array(node_update_us(setup))
    return figures
