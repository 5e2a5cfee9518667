"""The memory that runs need, estimated from their scenario before anything is drawn or started."""

import math
import resource
from collections.abc import Iterable
from functools import partial
from heapq import nlargest
from pathlib import Path

from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import generator
from concord.scenarios.types.assignment import check_ranges
from concord.scenarios.types.rules import smoothing_lags

# So many steps of nodes fit anywhere; the plant need not be built for an estimate.
_SMALL = 100_000
# Python objects of a step of a node that passes messages: measured at 2.5 kB.
_MESSAGES_BYTES = 2500
_FLOAT_BYTES = 8
_ADDRESSES_BYTES = 1024**3
# Measured: 4 nodes run with 32 files and not with 24, 16 nodes with 44 and not with 36.
_FILES_BASE = 28


def check_memory(scenario: Scenario, runs: int = 1, messages: bool = False) -> None:
    """Refuse runs at once that do not fit into the free memory, as far as the system names it.

    Raises:
        ValueError: naming the size of the runs, the estimate, what is free and the cure; or a
            scenario that cannot run.
    """
    if scenario.steps * scenario.nodes * runs <= _SMALL:
        return
    check_ranges(scenario)
    definition_of(scenario).refuse(scenario)
    size = f"--steps {scenario.steps} of {scenario.nodes} nodes"
    many = f" in {runs} runs" if runs > 1 else ""
    cure = f"use fewer --steps{', --runs' if runs > 1 else ''} or --nodes"
    require_memory(needed_bytes(scenario, runs, messages), f"{size}{many}", cure)


def needed_bytes(scenario: Scenario, runs: int = 1, messages: bool = False) -> int:
    """Return the bytes that the histories of runs at once take, with those of the filters beside.

    A node's step has beliefs of itself, of its filter alone, and their errors; its readings and
    their noise; and, with `messages`, the messages and the ages of all nodes. Links are not
    counted: a graph costs more to draw than the estimate is worth.
    """
    plant = definition_of(scenario).plant(scenario.with_(steps=1))
    noise = plant.draw(partial(generator, scenario), 1)
    n, readings = len(plant.state_names), math.ceil(noise.measurement.size / scenario.nodes)
    numbers = 2 * n**2 + 6 * n + 2 * readings + scenario.rounds + 8
    # Innovations of nodes and of the filter that hears everything, with covariances and NIS.
    numbers += 2 * (readings**2 + readings + 1)
    # Means and deviations of smoothed states, and their errors.
    numbers += 3 * n * smoothing_lags(scenario.rule)
    per_node = numbers * _FLOAT_BYTES
    if messages:
        per_node += _MESSAGES_BYTES + scenario.nodes * _FLOAT_BYTES
    return int(per_node * scenario.nodes * scenario.steps) * runs


def check_workers(needs: Iterable[int], workers: int) -> None:
    """Refuse pieces of work of so many bytes each, one at a time in each worker process, if the
    largest do not fit at once.

    Raises:
        ValueError: naming the workers, the estimate, what is free and the cure.
    """
    at_once = nlargest(workers, needs)
    if len(at_once) > 1:
        cure = "use fewer --workers, --steps or --nodes"
        require_memory(sum(at_once), f"{len(at_once)} --workers at once", cure)


def require_memory(needed: int, what: str, cure: str) -> None:
    """Refuse an estimate that exceeds the free memory.

    Raises:
        ValueError: naming what needs it, the estimate, what is free and the cure.
    """
    free_mb = available_memory_mb()
    if free_mb is not None and needed > free_mb * 1024**2:
        raise ValueError(
            f"{what}: about {_size(needed / 1024**2)} of memory are needed and {_size(free_mb)} "
            f"are free; {cure}"
        )


def check_address_space(driver: str) -> None:
    """Refuse a network of processes where the system limits the address space of each too much.

    Threads reserve address space for their stacks that they never use, so a process of a small
    network reserves about 800 MB and uses 60 MB.

    Raises:
        ValueError: naming the limit and the cure.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _ADDRESSES_BYTES:
        raise ValueError(
            f"--driver {driver}: the system limits the address space of a process to "
            f"{_size(limit / 1024**2)}, and a process of the network reserves about "
            f"{_size(_ADDRESSES_BYTES / 1024**2)}; raise the limit (ulimit -v), or use --driver "
            "in-process"
        )


def files_needed(nodes: int) -> int:
    """Return how many files the recorder of a network of processes opens, with some to spare."""
    return _FILES_BASE + nodes


def check_files(driver: str, nodes: int) -> None:
    """Refuse a network of processes that may open too few files: links would fail in silence.

    The launcher raises the soft limit to the hard one, which counts here.

    Raises:
        ValueError: naming the limit, the need and the cure.
    """
    _, limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    need = files_needed(nodes)
    if limit != resource.RLIM_INFINITY and limit < need:
        raise ValueError(
            f"--driver {driver}: a process may open {limit} files, and a network of {nodes} nodes "
            f"needs {need}; raise the limit (ulimit -n {need}), or use --driver in-process"
        )


def _size(megabytes: float) -> str:
    return f"{megabytes / 1024:,.1f} GB" if megabytes >= 1024 else f"{megabytes:.0f} MB"


def available_memory_mb(
    proc: Path = Path("/proc"), group: Path = Path("/sys/fs/cgroup")
) -> float | None:
    """Free memory as the kernel counts it, or what is left to this container if that is less."""
    try:
        lines = (proc / "meminfo").read_text().splitlines()
        fields = dict(line.split(":", 1) for line in lines if ":" in line)
        free = int(fields["MemAvailable"].split()[0]) / 1024
    except (OSError, KeyError, ValueError):
        return None
    try:
        limit = int((group / "memory.max").read_text())
        used = int((group / "memory.current").read_text())
    except (OSError, ValueError):
        # No such group, or the word max.
        return free
    return min(free, (limit - used) / 1024**2)
