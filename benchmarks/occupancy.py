"""Error against bus occupancy on TRACK: held shares as they are, beside the default.

Source: `concord`'s study of consensus under FlexRay limits; the scenario is `target-tracking`.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from scipy import stats

from experiments.results.summary import summarise
from experiments.results.trace import read_trace
from experiments.scenario_options import scenario_of
from runtime.drivers import in_memory
from scenarios.preparation import prepare

HOLDS, DEFAULT = ("raw", "decayed"), "decayed"
OCCUPANCIES = (1.0, 0.5, 0.25, 0.1)
RUNS, WORKERS, CONFIDENCE = 20, 2, 0.95


class OccupancyJob(NamedTuple):
    """One run of one cell of the table."""

    hold: str
    occupancy: float
    run: int


class OccupancyCell(NamedTuple):
    """RMSE over that of the centralised filter on the same noise: mean over runs and half width of
    its t-interval; RMSE in metres and ANEES are means over runs."""

    ratio: float
    half_width: float
    rmse_m: float
    anees: float


def main() -> dict[str, dict[str, float]]:
    """Print and return the table, one cell per hold policy and occupancy."""
    jobs = [
        OccupancyJob(hold, part, run)
        for hold in HOLDS
        for part in OCCUPANCIES
        for run in range(RUNS)
    ]
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        outcomes = np.array(list(pool.map(_outcome, jobs, chunksize=4)))
    cells = _cells(outcomes.reshape(len(HOLDS), len(OCCUPANCIES), RUNS, -1))
    out = sys.stdout.write
    out(
        f"occupancy, target-tracking, 20 nodes, {RUNS} runs: RMSE over that of the centralised "
        f"filter, mean over runs and {100 * CONFIDENCE:.0f} % t-interval\n"
        f"{'hold':<10}{'occupancy':>9}{'x centralised':>20}{'RMSE m':>10}{'ANEES':>10}\n"
    )
    for (hold, part), cell in cells.items():
        ratio = f"{cell.ratio:.2f} +- {cell.half_width:.2f}"
        out(f"{hold:<10}{part:>9g}{ratio:>20}{cell.rmse_m:>10.1f}{cell.anees:>10.2f}\n")
    low, high = OCCUPANCIES[-1], OCCUPANCIES[0]
    degradation = cells["raw", low].ratio / cells["raw", high].ratio
    worst = max(cells[DEFAULT, part].ratio for part in OCCUPANCIES)
    out(f"raw hold degrades {degradation:.1f} x (expected: at least 10)\n")
    out(f"default at most {worst:.2f} x centralised (expected: below 3)\n")
    return {f"{hold} {part:g}": cell._asdict() for (hold, part), cell in cells.items()}


def _outcome(job: OccupancyJob) -> tuple[float, float, float]:
    """RMSE over centralised, RMSE and ANEES of one run."""
    options = scenario_of(
        scenario="target-tracking", nodes=20, occupancy=job.occupancy, hold=job.hold, run=job.run
    )
    setup = prepare(options)
    figures = summarise(setup, read_trace(setup, in_memory(setup)))
    return figures.rmse / figures.rmse_centralised, figures.rmse, figures.anees


def _cells(outcomes: np.ndarray) -> dict[tuple[str, float], OccupancyCell]:
    """From outcomes (holds, occupancies, runs, 3)."""
    quantile = stats.t.ppf(0.5 + CONFIDENCE / 2, RUNS - 1)
    mean, spread = outcomes.mean(2), outcomes.std(2, ddof=1)
    return {
        (hold, part): OccupancyCell(
            float(mean[i, j, 0]),
            float(quantile * spread[i, j, 0] / np.sqrt(RUNS)),
            float(mean[i, j, 1]),
            float(mean[i, j, 2]),
        )
        for i, hold in enumerate(HOLDS)
        for j, part in enumerate(OCCUPANCIES)
    }
