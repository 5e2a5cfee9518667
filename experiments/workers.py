"""Where the pieces of a sweep are computed: in this process, in others of this machine, over Dask.

An engine takes a function and its arguments and yields (place, result) as they become ready. What
leaves an engine early, an error or Ctrl-C, ends its work.
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any

Engine = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]


class WorkerLost(RuntimeError):
    """A worker process ended by itself."""


def engine_for(workers: int | None, dask: str | None) -> Engine:
    """The engine that options ask for: so many processes here, or a Dask scheduler's address.

    Raises:
        ValueError: fewer than one worker, both asked for, or Dask is not there.
    """
    if dask is not None:
        if workers is not None:
            raise ValueError(
                "--workers and --dask: Dask has its own workers; leave one of them out"
            )
        from experiments.dask_workers import connect

        return connect(dask)
    if workers is not None and workers < 1:
        raise ValueError(f"--workers {workers}: must be at least 1")
    # The cores that this process may use, which a container may have limited.
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return partial(in_processes, workers or available or 1)


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
