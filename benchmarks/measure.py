"""How everything here is measured: contestants in turns, medians, and the spread of what they give.

The machine is never quiet. Contestants therefore take turns, and a ratio is taken within a turn, so
that what slows one slows the other; low and high are the quartiles over the turns.
"""

import os
import platform
import resource
import statistics
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from concord.studies.monte_carlo.simulate import keep_freed_memory

Better = Literal["more", "less"]
FULL_BUS = {"rule": "ci", "number": "float64", "schedule": "full"}
"""The options of the networks that are timed: each node averages what all its neighbours say."""


class BenchmarkFigure(msgspec.Struct, frozen=True):
    """A measured value, its quartiles over the turns, and which way is better."""

    value: float
    low: float
    high: float
    unit: str
    better: Better


BenchmarkFigures = dict[str, BenchmarkFigure]


def figure(values: list[float], unit: str, better: Better) -> BenchmarkFigure:
    """Median and quartiles."""
    low, middle, high = np.percentile(values, (25, 50, 75)).tolist()
    return BenchmarkFigure(middle, low, high, unit, better)


def in_turns(contestants: Mapping[str, Callable[[], float]], turns: int) -> dict[str, list[float]]:
    """Return each contestant's seconds per unit of work, turn by turn.

    The first turn loads and compiles, so it is left out.
    """
    keep_freed_memory()
    given: dict[str, list[float]] = {name: [] for name in contestants}
    for turn in range(turns + 1):
        for name, run in contestants.items():
            spent = run()
            if turn:
                given[name].append(spent)
    return given


def ratio(over: list[float], under: list[float]) -> BenchmarkFigure:
    """Return how many times as fast the second is as the first."""
    return figure([a / b for a, b in zip(over, under, strict=True)], "x", "more")


def peak_mb() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def machine() -> dict[str, str]:
    """Return the machine and the versions on which the figures were measured."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text().splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        cpu = f"{len(names)} x {names[0]}" if names else cpu
    return {
        "cpu": cpu,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "load": " ".join(f"{value:.1f}" for value in os.getloadavg()),
    }


def say(text: str) -> None:
    """A line of the report."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def median_us(values: list[float]) -> float:
    """Median in microseconds."""
    return 1e6 * statistics.median(values)


def table(results: dict[str, BenchmarkFigures]) -> str:
    """One line per figure, in the order of measuring: median, quartiles, unit."""
    lines = [f"{'':<50}{'median':>10}{'quartiles':>22}"]
    for bench, figures in results.items():
        lines += ["", bench]
        lines += [f"  {name:<48}{_in_numbers(figure)}" for name, figure in figures.items()]
    return "\n".join(lines)


def _in_numbers(figure: BenchmarkFigure) -> str:
    quartiles = f"{figure.low:.4g} - {figure.high:.4g}"
    return f"{figure.value:>10.4g}{quartiles:>22}  {figure.unit}".rstrip()
