"""Two workers of a sweep against one: the processor time that the second one costs.

Workers share nothing but pieces and results, so on a free machine the clock follows the processor
time. The start-up of each process, some 2 s, is shown apart: it is that of a short sweep.
"""

import resource
import subprocess
import tempfile
from pathlib import Path

from benchmarks.measure import BenchmarkFigures, figure, ratio, say
from concord.runtime.interpreter import fresh_command, fresh_variables

# The short sweep has two pieces, so that it starts both workers too; the long one has eight.
RUNS, SHORT_RUNS, TURNS = 12_000, 2000, 3
WORKERS = (1, 2)


def main() -> BenchmarkFigures:
    """Print and return the efficiency of two workers, with and without their start-up."""
    whole: dict[int, list[float]] = {workers: [] for workers in WORKERS}
    work: dict[int, list[float]] = {workers: [] for workers in WORKERS}
    for _ in range(TURNS):
        for workers in WORKERS:
            short_s, long_s = (_spent_s(runs, workers) for runs in (SHORT_RUNS, RUNS))
            whole[workers].append(long_s)
            work[workers].append(long_s - short_s)
    results: BenchmarkFigures = {
        f"{workers} workers s": figure(spent, "s", "less") for workers, spent in whole.items()
    }
    say(f"oscillator, 20 nodes, 60 steps, {RUNS} runs, moments; {TURNS} turns")
    for name, spent in (("", whole), (", start-up left out", work)):
        found = results[f"efficiency of two workers{name}"] = ratio(spent[1], spent[2])
        say(f"  efficiency by processor time{name}: {found.value:.2f} "
            f"({found.low:.2f} - {found.high:.2f})")  # fmt: skip
    return results


def _spent_s(runs: int, workers: int) -> float:
    """Processor time of a sweep and its workers."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        words = (
            *("sweep", "--scenario", "oscillator", "--nodes", "20", "--steps", "60"),
            *("--runs", str(runs), "--keep", "moments", "--workers", str(workers)),
            *("--out", str(Path(folder) / "sweep.nc")),
        )
        subprocess.run(
            [*fresh_command("concord.experiments"), *words],
            env=fresh_variables(OPENBLAS_NUM_THREADS="1"),
            capture_output=True,
            check=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
