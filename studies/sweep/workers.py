"""Engines on this machine: pieces of a sweep in this process or in several others.

An engine takes a function and its arguments and yields (place, result) as they become ready. An
error or Ctrl-C ends its work.
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from concord.disk import RunFailed

Engine = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]


class WorkerLost(RunFailed):
    """A worker process ended by itself."""


def in_this_process(
    function: Callable[[Any], Any], arguments: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    """One after the other."""
    for place, argument in enumerate(arguments):
        yield place, function(argument)


def in_processes(
    workers: int, function: Callable[[Any], Any], arguments: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    """In so many fresh processes of one BLAS thread each; here if there is only one thing to do.

    Raises:
        WorkerLost: a worker was killed, most likely for want of memory.
    """
    workers = min(workers, len(arguments))
    if workers <= 1:
        yield from in_this_process(function, arguments)
        return
    # Read by numpy when a fresh process loads it: two workers must not fight for the cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=_leave_interrupts_to_the_parent)
    try:
        waiting = {pool.submit(function, argument): n for n, argument in enumerate(arguments)}
        for done in as_completed(waiting):
            yield waiting.pop(done), done.result()
        pool.shutdown()
    except BrokenProcessPool:
        raise WorkerLost(
            "a worker process was killed, most likely for want of memory; use fewer --workers"
        ) from None
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
            process.join()


def _leave_interrupts_to_the_parent() -> None:
    # Ctrl-C reaches every process of the terminal; only the parent knows what to keep.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
