"""Processor time of processes that run: what they cost, however busy the machine is with others.

Reason for a file of its own: the comparison of two runs imports it without the benchmarks.
"""

import os
from collections.abc import Iterable
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def spent_s(processes: Iterable[int]) -> float:
    """Processor time of these processes and of their children, in seconds; 0 for a process that has
    ended.

    The kernel counts whole ticks (10 ms as a rule), so up to four of them per process are missing.
    Source: proc(5), /proc/PID/stat, fields utime to cstime.
    """
    return sum(_spent_s(process) for process in processes)


def _spent_s(process: int) -> float:
    place = Path(f"/proc/{process}")
    try:
        # The name, in parentheses, may hold anything.
        fields = (place / "stat").read_text().rpartition(")")[2].split()
        children = [
            int(child)
            for thread in (place / "task").iterdir()
            for child in (thread / "children").read_text().split()
        ]
    except FileNotFoundError:
        return 0.0
    return sum(map(int, fields[11:15])) / _TICKS_PER_S + spent_s(children)
