"""Exact errors beside those of many runs, on six networks, and the processor time of both.

The first table has the mean squared error over nodes and scored steps. With losses the exact
errors are those of the first runs' patterns. The second table has the seconds of `cc.exact` beside
those of as many runs as give the error of one node in one step, or of the network, to 1 %.
"""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro

import concord as cc
from concord.papers.kit.report import markdown_table
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.studies.exact.network import exact_network
from concord.studies.exact.results import Exact, exact_of
from concord.studies.monte_carlo.simulate import keep_freed_memory, simulate
from concord.studies.progress import progress

STEPS, TOGETHER = 30, 2500
ROUND_ROBIN = {"schedule": "round-robin", "rounds": 1}
OF_95, OF_999 = 1.96, 3.29
PRECISION = 0.01


class Squares(NamedTuple):
    """Mean squared error over nodes and scored steps of each run (R,), that of the last node in the
    last step (R,), and the processor's seconds."""

    network: np.ndarray
    one: np.ndarray
    seconds: float


def _shipped(name: str, **options: Any) -> Scenario:
    return cc.scenario(name, **{"rule": "ci", "rounds": 2, "schedule": "full", **options})


def _own(sensors: list[Any], pole: float) -> Scenario:
    move = np.array([[pole, 0.1], [0.0, 0.95]])
    plant = cc.OwnPlant(
        f=lambda x: x @ move.T, Q=[1e-3, 1e-2], mean=[1, 0], cov=[1, 1], time_step_s=0.1
    )
    own = cc.own_scenario(plant, sensors, steps=STEPS)
    return own.with_(number="float64", schedule="full", bus="ideal", rule="ci", rounds=2)


def _place() -> cc.OwnSensor:
    return cc.OwnSensor(h=lambda x: x[..., :1], R=0.1)


NETWORKS: dict[str, Callable[[], Scenario]] = {
    "held shares": lambda: _shipped("oscillator", **ROUND_ROBIN, occupancy=0.25, steps=STEPS),
    "30 % loss": lambda: _shipped("oscillator", loss=0.3, nodes=5, rounds=1, steps=STEPS),
    "period of 7 steps": lambda: _shipped(
        "dc-motor-speed", **ROUND_ROBIN, occupancy=1 / 7, nodes=7, steps=STEPS
    ),
    "unstable plant": lambda: _own([_place()] * 5, 1.05),
    "blind nodes": lambda: _own([_place(), *[None] * 5], 0.99),
    "wrong Q": lambda: _shipped("dc-motor-speed", noise="paper", steps=STEPS),
}
PLANTS = ("oscillator", "dc-motor-speed", "dc-motor-position", "suspension", "cruise-control")


@dataclass(frozen=True, kw_only=True)
class ExactOptions:
    """How much work."""

    networks: tuple[str, ...] = tuple(NETWORKS)
    """Networks of the first table."""
    runs: int = 100_000
    """Runs of each network."""
    patterns: int = 1000
    """Patterns of losses of the network with losses."""
    timed_runs: int = 300
    """Runs that are timed for the second table."""


def exact(options: Annotated[ExactOptions, tyro.conf.arg(name="")]) -> None:
    """Compare, print two tables, and exit with 1 where runs differ by more than noise."""
    keep_freed_memory()
    apart = []
    head = ("network", "mean squared error", "runs differ by", "95 % interval", "deviations")
    _say(f"{options.runs} runs:\n\n{markdown_table(head, [])}")
    for name in options.networks:
        row, off = _compared(name, NETWORKS[name](), options)
        _say(_row(row))
        if off > OF_999:
            apart.append(name)
    head = ("plant", "s exact", "runs, a node and step", "times", "runs, network", "times")
    _say(f"\nprocessor time, runs for 1 %:\n\n{markdown_table(head, [])}")
    for name in PLANTS:
        _say(_row(_timed(name, options.timed_runs)))
    if apart:
        _say(f"differ: {', '.join(apart)}")
        sys.exit(1)


def _compared(name: str, scenario: Scenario, options: ExactOptions) -> tuple[list[str], float]:
    """The row of a network, and the difference in standard deviations."""
    setup = prepare(scenario)
    found = exact_of(setup, range(options.patterns))
    scored = found.squares[:, found.scored].mean(axis=(1, 2))
    of_runs = [
        squares_of(scenario, found, range(first, min(first + TOGETHER, options.runs)))
        for first in _in_progress(name, options.runs)
    ]
    squares = np.concatenate([one.network for one in of_runs])
    variance = squares.var() / len(squares) + scored.var() / len(scored)
    middle = scored.mean()
    relative, std = squares.mean() / middle - 1, np.sqrt(variance) / middle
    cells = [name, f"{middle:.6g}", f"{relative:+.3%}", f"±{OF_95 * std:.3%}"]
    return [*cells, f"{relative / std:+.2f}"], float(abs(relative / std))


def _in_progress(name: str, runs: int) -> Iterator[int]:
    with progress(name, runs) as done:
        for first in range(0, runs, TOGETHER):
            yield first
            done(min(first + TOGETHER, runs))


def squares_of(scenario: Scenario, found: Exact, runs: range) -> Squares:
    """Squared errors of runs of the network that the exact engine has."""
    setup, started = exact_network(prepare(scenario)).setup, time.thread_time()
    simulated = simulate(setup, runs, keep=())
    seconds = time.thread_time() - started
    states = list(definition_of(scenario).score.states)
    errors = (simulated.mean - simulated.truth[:, :, None])[..., states]
    squares = (errors**2).sum(axis=-1)
    return Squares(squares[:, found.scored].mean(axis=(1, 2)), squares[:, -1, -1], seconds)


def _timed(name: str, runs: int) -> list[str]:
    scenario = _shipped(name)
    setup = prepare(scenario)
    found = exact_of(setup)
    started = time.thread_time()
    exact_of(setup)
    seconds = time.thread_time() - started
    squares = squares_of(scenario, found, range(runs))
    cells = [name, f"{seconds:.2f}"]
    for values in (squares.one, squares.network):
        # A root errs by half of what its square errs, relatively.
        needed = (OF_95 * values.std() / values.mean() / 2 / PRECISION) ** 2
        cells += [f"{needed:.0f}", f"{needed * squares.seconds / runs / seconds:.0f}"]
    return cells


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
