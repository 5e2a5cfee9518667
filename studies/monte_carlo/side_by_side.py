"""Parts of a work side by side in threads: numpy leaves the processors to others as it computes."""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context


def processors() -> int:
    """Return the number of processors that this process may use."""
    # A container may have limited them.
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return available or 1


class _Stopped(Exception):
    """A part of the work ends, because another part failed or the user pressed Ctrl-C."""


def side_by_side(
    work: Callable[[slice, Callable[[], None]], None], parts: Sequence[slice], threads: int
) -> Iterator[slice]:
    """Do the work of all parts, and yield each part in order when it and those before are done.

    Args:
        work: takes a slice, and a function that it calls now and then, which ends it early.
        parts: what there is to do.
        threads: how many parts are done at once; with 1 the caller's own thread does them.

    Raises:
        Exception: what the first part that failed has raised; the other parts end.
    """
    if min(threads, len(parts)) <= 1:
        for part in parts:
            work(part, lambda: None)
            yield part
        return
    stopped = threading.Event()

    def go_on() -> None:
        if stopped.is_set():
            raise _Stopped

    with ThreadPoolExecutor(threads) as pool:
        # numpy keeps in a context what floating-point errors do.
        done = [pool.submit(copy_context().run, work, part, go_on) for part in parts]
        try:
            for part, future in zip(parts, done, strict=True):
                future.result()
                yield part
        finally:
            stopped.set()
