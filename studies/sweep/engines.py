"""The engine that computes the pieces of a sweep, as the options ask for it."""

from functools import partial
from pathlib import Path

from concord.studies.monte_carlo.side_by_side import processors
from concord.studies.sweep.dask_workers import connect
from concord.studies.sweep.workers import Engine, in_processes


def workers_here(workers: int | None, dask: str | None = None) -> int:
    """Return the number of worker processes on this machine: one per core that this process may
    use where none is asked for, and one where Dask has workers of its own.

    Raises:
        ValueError: fewer than one.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"--workers {workers}: must be at least 1")
    return 1 if dask is not None else workers or processors()


def engine_for(
    workers: int | None, dask: str | None, dask_tls: Path | None = None, dask_wait_s: float = 0.0
) -> Engine:
    """Return the engine of so many processes here, or of the Dask scheduler at an address.

    Raises:
        ValueError: fewer than one worker, both asked for, or Dask is not there.
    """
    if dask is not None:
        if workers is not None:
            raise ValueError(
                "--workers and --dask: Dask has its own workers; leave one of them out"
            )
        return connect(dask, dask_tls, dask_wait_s)
    if dask_tls is not None:
        raise ValueError(f"--dask-tls {dask_tls}: is for --dask tls://HOST:8786; give both")
    return partial(in_processes, workers_here(workers))
