"""Work that gives way: to a network on the same machine, which people wait for."""

import contextlib
import os
from pathlib import Path


def give_way(niceness: int, process: int = 0) -> None:
    """Lower the priority of a process (0: this one), and of its session where that is its own.

    Linux shares the processor among sessions first and among the processes of each then (autogroup
    in sched(7)): there a niceness counts against nobody outside of the session, however high.
    """
    process = process or os.getpid()
    lowest = max(niceness, os.getpriority(os.PRIO_PROCESS, process))
    os.setpriority(os.PRIO_PROCESS, process, lowest)
    if os.getsid(process) == process:
        # Elsewhere, and where it is switched off, the niceness is enough.
        with contextlib.suppress(OSError):
            Path(f"/proc/{process}/autogroup").write_text(f"{niceness}\n")
