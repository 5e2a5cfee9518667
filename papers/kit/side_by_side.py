"""The independent parts of a reproduction, on all cores of the machine."""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from concord.studies.progress import progress
from concord.studies.sweep.engines import workers_here
from concord.studies.sweep.workers import in_processes

Job = TypeVar("Job")
Result = TypeVar("Result")


def side_by_side(
    title: str, work: Callable[[Job], Result], jobs: Sequence[Job], workers: int | None = None
) -> list[Result]:
    """Return the results of `work` in the order of the jobs, with one process for each core.

    Work and jobs travel to other processes, so they must be picklable. The results do not depend
    on the number of workers.

    Raises:
        WorkerLost: a worker was killed, most likely for want of memory.
    """
    found: dict[int, Result] = {}
    with progress(title, len(jobs)) as on_done:
        for place, result in in_processes(workers_here(workers), work, jobs):
            found[place] = result
            on_done(len(found))
    return [found[place] for place in range(len(jobs))]


def by_name(title: str, work: Callable[[str], Result], names: Iterable[str]) -> dict[str, Result]:
    """Return the result of `work` for each name, as `side_by_side` computes it."""
    jobs = list(names)
    return dict(zip(jobs, side_by_side(title, work, jobs), strict=True))
