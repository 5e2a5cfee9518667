"""A Dask scheduler whose workers are jobs of SLURM (docs/clusters.md): python dask_slurm.py JOBS.

It prints the address for `concord sweep --dask`, and runs until Ctrl-C. `PBSCluster` in the place
of `SLURMCluster` makes jobs of PBS. Needs `pip install dask-jobqueue`, and concord in the same
place on all machines.
"""

import contextlib
import sys
import time
from typing import Any

from dask_jobqueue import SLURMCluster  # pyright: ignore[reportPrivateImportUsage]


def main(jobs: int) -> None:
    """Start the scheduler and so many jobs; each has four workers of one thread."""
    # Dask's types say that only an asynchronous cluster is made.
    made: Any = SLURMCluster(
        cores=4,
        processes=4,
        memory="4GB",
        walltime="04:00:00",
        job_script_prologue=["export OPENBLAS_NUM_THREADS=1"],
    )
    with made as cluster:
        cluster.scale(jobs=jobs)
        sys.stdout.write(f"{cluster.scheduler_address}\n")
        sys.stdout.flush()
        # Ctrl-C cancels the jobs. Where another thread gets its signal, `signal.pause` would go on.
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                time.sleep(1.0)


if __name__ == "__main__":
    main(int(sys.argv[1]))
