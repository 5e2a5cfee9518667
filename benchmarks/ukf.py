"""UKF steps beside filterpy, Stone Soup, a loop in C and libraries on JAX: one filter, and ten
thousand of them."""

import statistics
import time
from collections.abc import Callable

import numpy as np

from benchmarks.cases import BenchmarkCase, beliefs, readings, straight, turn
from benchmarks.jax_peers import installed, jax_loops
from benchmarks.measure import BenchmarkFigures, figure, in_turns, median_us, ratio, say
from benchmarks.peers import c_loop, filterpy_loop, stone_soup_loop
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.filters.ukf import predict, update

LANES, TURNS = 10_000, 15
# As many at a time as fit into the caches with all their sigma points.
BLOCK = 2_000
ONE_STEPS, MANY_STEPS = 200, 3


def ours(
    case: BenchmarkCase, blocks: int, lanes: tuple[int, ...], steps: int
) -> Callable[[], float]:
    """Seconds per lane and step of a chain of steps from the start, block by block of lanes."""
    rule, taken = scaled_unscented(len(case.start.mean)), _lanes_last(readings(case, lanes))
    count = blocks * max(1, taken.size // 2)

    def run() -> float:
        held = [beliefs(case, lanes) for _ in range(blocks)]
        started = time.thread_time()
        for _ in range(steps):
            held = [advance(belief) for belief in held]
        return (time.thread_time() - started) / (steps * count)

    def advance(belief: Gaussian) -> Gaussian:
        belief = predict(belief, case.transition, case.process_noise_cov, rule)
        noise_cov, residual = case.measurement_noise_cov, case.residual
        return update(belief, taken, case.measure, noise_cov, rule, residual=residual).belief

    return run


def _lanes_last(readings: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(readings.T).T


def main() -> BenchmarkFigures:
    """Print and return steps per second and ratios of both cases."""
    results: BenchmarkFigures = {}
    say(installed())
    for case in (straight(), turn()):
        contestants = {
            "filterpy": filterpy_loop(case),
            "Stone Soup": stone_soup_loop(case),
            "numpy, one": ours(case, 1, (), ONE_STEPS),
            "numpy, many": ours(case, LANES // BLOCK, (BLOCK,), MANY_STEPS),
        }
        if (in_c := c_loop(case)) is not None:
            contestants["C loop"] = in_c
        contestants |= jax_loops(case, LANES, MANY_STEPS)
        given = in_turns(contestants, TURNS)
        say(
            f"UKF, case {case.name}, n = {len(case.start.mean)}, m = 2; {LANES} lanes, "
            f"{TURNS} turns, one core"
        )
        say(
            f"  {'':<16}{'us / step':>12}{'M steps / s':>12}{'x filterpy':>12}"
            f"{'(quartiles)':>16}{'x Stone Soup':>14}{'% of C':>8}"
        )
        for name, spent in given.items():
            beside = ratio(given["filterpy"], spent)
            soup = ratio(given["Stone Soup"], spent)
            part = 100 * ratio(given["C loop"], spent).value if "C loop" in given else float("nan")
            say(
                f"  {name:<16}{median_us(spent):>12.3f}{1 / statistics.median(spent) / 1e6:>12.4f}"
                f"{beside.value:>12.1f}{f'{beside.low:.1f} - {beside.high:.1f}':>16}"
                f"{soup.value:>14.1f}{part:>8.0f}"
            )
            key = f"{case.name} {name}"
            results[f"{key} us"] = figure([1e6 * one for one in spent], "us/step", "less")
            results[f"{key} x filterpy"] = beside
    return results


if __name__ == "__main__":
    main()
