"""A Monte Carlo from end to end beside the filter steps and fusions that it cannot do without.

20 nodes, 500 runs, 100 steps, 3 rounds. End to end means `simulate`: noise,
plant, sensors, schedule, weights by determinants and age, fusion, metrics, histories. Beside it
stand the functions that it calls for all its lanes at once: `ukf.predict` and `ukf.update`, with
the same models and readings, and the rounds of its rule, `start` and `exchange`.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.fusion import fuse
from benchmarks.measure import FULL_BUS, BenchmarkFigures, figure, in_turns, peak_mb, say
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.filters.ukf import predict, update
from concord.plants.targets import Target
from concord.runtime.batched.build import build_network
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import READINGS, simulate

SCENARIO, NODES, RUNS, STEPS, KERNEL_STEPS, TURNS = "target-tracking", 20, 500, 100, 10, 5


def _setup(steps: int) -> Setup:
    return prepare(scenario_of(scenario=SCENARIO, nodes=NODES, steps=steps, seed=1, **FULL_BUS))


def main() -> BenchmarkFigures:
    """Print and return seconds of the processor, and the ratio of the whole to its kernels."""
    setup = _setup(STEPS)
    parts = {
        "end to end": partial(_whole, setup),
        "UKF": _filters(setup),
        "fusion": _fusions(setup),
    }
    given = in_turns({f"numpy, {name}": run for name, run in parts.items()}, TURNS)
    say(
        f"Monte Carlo, {NODES} nodes x {RUNS} runs x {STEPS} steps x {setup.scenario.rounds} "
        f"rounds, {TURNS} turns"
    )
    results = _beside_kernels("numpy", given)
    results["peak MB"] = figure([peak_mb()], "MB", "less")
    say(f"  peak {peak_mb():.0f} MB")
    return results


def _beside_kernels(kind: str, given: dict[str, list[float]]) -> BenchmarkFigures:
    """Seconds of the whole and of its filter steps and fusions, and their ratio."""
    whole, filters, fusions = (given[f"{kind}, {name}"] for name in ("end to end", "UKF", "fusion"))
    over = [a / (b + c) for a, b, c in zip(whole, filters, fusions, strict=True)]
    results = {
        f"{kind}, end to end s": figure(whole, "s", "less"),
        f"{kind}, UKF s": figure(filters, "s", "less"),
        f"{kind}, fusion s": figure(fusions, "s", "less"),
        f"{kind}, end to end over kernels": figure(over, "x", "less"),
    }
    all_told, ukf, fusion, ratio = results.values()
    say(
        f"  {kind}: {all_told.value:.2f} s end to end, "
        f"{1e6 * all_told.value / (NODES * RUNS * STEPS):.2f} us a node and step; kernels "
        f"{ukf.value:.2f} s of UKF and {fusion.value:.2f} s of fusion; ratio {ratio.value:.2f} "
        f"({ratio.low:.2f} - {ratio.high:.2f})"
    )
    return results


def _whole(setup: Setup) -> float:
    started = time.thread_time()
    simulate(setup, range(RUNS), keep=())
    return time.thread_time() - started


def _start(setup: Setup) -> Gaussian:
    """Return the priors of all nodes and runs, lanes last in memory as filters leave them."""
    n = len(setup.prior_mean)
    mean, cov = np.empty((n, RUNS, NODES)), np.empty((n, n, RUNS, NODES))
    mean[:] = np.array(setup.prior_mean)[:, None, None]
    cov[:] = np.array(setup.prior_cov).reshape(n, n, 1, 1)
    return Gaussian(mean.transpose(1, 2, 0), cov.transpose(2, 3, 0, 1))


def _filters(setup: Setup) -> Callable[[], float]:
    definition = definition_of(setup.scenario)
    plant = definition.plant(setup.scenario)
    assert isinstance(plant, Target)
    model, sensors = plant.model, plant.sensors
    rule, start = scaled_unscented(len(setup.prior_mean)), _start(setup)
    short = prepare(
        scenario_of(scenario=SCENARIO, nodes=NODES, steps=KERNEL_STEPS, seed=1, **FULL_BUS)
    )
    readings = simulate(short, range(RUNS), keep=(READINGS,)).readings
    assert readings is not None

    def run() -> float:
        belief = start
        started = time.thread_time()
        for step in range(KERNEL_STEPS):
            belief = predict(
                belief,
                partial(model.transition, control=None, step=step),
                model.process_noise_cov(step),
                rule,
            )
            value, noise_cov = sensors.interpret(readings[:, step, :, 0])
            belief = update(
                belief,
                value,
                partial(sensors.measure, step=step),
                noise_cov,
                rule,
                residual=sensors.residual,
            ).belief
        return (time.thread_time() - started) * STEPS / KERNEL_STEPS

    return run


def _fusions(setup: Setup) -> Callable[[], float]:
    start, rule = _start(setup), build_network(setup, range(RUNS)).segments[0].settings.rule

    def run() -> float:
        belief = start
        started = time.thread_time()
        for _ in range(KERNEL_STEPS):
            belief = fuse(rule, belief, setup.scenario.rounds)
        return (time.thread_time() - started) * STEPS / KERNEL_STEPS

    return run


if __name__ == "__main__":
    main()
