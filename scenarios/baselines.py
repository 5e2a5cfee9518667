"""The two filters that frame every network: one that hears everything, and each node alone.

Both are computed after the run from what its sensors delivered, by the same filter functions, so
they see the same noise in every driver.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule, scaled_unscented
from filters.ukf import predict, update
from nodes.belief_consensus import Sensor
from nodes.messages import Array
from scenarios.catalogue import kind_of
from scenarios.rules import rule_of
from scenarios.setup import Setup

Listener = Callable[[Gaussian, int, Array, Array | None], Gaussian]
"""(belief of the step before, step, readings (N, r, d), control (p,)) -> belief of the step."""


def centralised(setup: Setup, readings: Array, control: Array | None) -> Gaussian:
    """One filter that takes all readings (steps, N, r, d): mean (steps, n), cov (steps, n, n)."""
    nodes = range(setup.scenario.nodes)
    return _filter(setup, list(nodes), readings, control)


def local_only(setup: Setup, readings: Array, control: Array | None) -> Gaussian:
    """Each node with its own readings alone: mean (steps, N, n), cov (steps, N, n, n)."""
    alone = [_filter(setup, [node], readings, control) for node in range(setup.scenario.nodes)]
    return Gaussian(
        np.stack([belief.mean for belief in alone], axis=1),
        np.stack([belief.cov for belief in alone], axis=1),
    )


def _filter(setup: Setup, nodes: list[int], readings: Array, control: Array | None) -> Gaussian:
    kind = kind_of(setup.scenario.name)
    if kind.listen is not None:
        return kind.listen(setup, nodes, readings)
    rule_listens = rule_of(setup.scenario).listen
    if rule_listens is not None:
        return rule_listens(setup, nodes, readings, control)
    step_of = listener(setup, nodes)
    belief = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    means, covs = [], []
    for step, delivered in enumerate(readings):
        belief = step_of(belief, step, delivered, None if control is None else control[step])
        means.append(belief.mean)
        covs.append(belief.cov)
    return Gaussian(np.array(means), np.array(covs))


def listens_step_by_step(setup: Setup) -> bool:
    """Whether `listener` is the filter of this scenario; others listen to a whole run at once."""
    kind = kind_of(setup.scenario.name)
    return kind.listen is None and rule_of(setup.scenario).listen is None


def listener(setup: Setup, nodes: list[int]) -> Listener:
    """One filter that takes the readings of these nodes, one step at a time."""
    kind = kind_of(setup.scenario.name)
    model = kind.model(setup.scenario)
    points = scaled_unscented(len(setup.prior_mean))
    sensors = {node: kind.sensor(setup.scenario, node) for node in nodes}

    def listen(belief: Gaussian, step: int, delivered: Array, driven: Array | None) -> Gaussian:
        if step > 0:
            transition = partial(model.transition, control=driven, step=step - 1)
            belief = predict(belief, transition, model.process_noise_cov(step - 1), points)
        taken = [
            (sensor, reading)
            for node, sensor in sensors.items()
            for reading in delivered[node]
            if sensor is not None and not np.isnan(reading).all()
        ]
        for group in _together(taken):
            belief = _take(belief, group, step, points)
        return belief

    return listen


def _together(taken: list[tuple[Sensor, Array]]) -> list[list[tuple[Sensor, Array]]]:
    """All readings of a step at once; one by one where a gate judges each by itself."""
    if any(sensor.gate is not None for sensor, _ in taken):
        return [[one] for one in taken]
    return [taken] if taken else []


def _take(
    belief: Gaussian, group: list[tuple[Sensor, Array]], step: int, points: SigmaPointRule
) -> Gaussian:
    interpreted = [sensor.interpret(reading) for sensor, reading in group]
    sizes = np.cumsum([len(value) for value, _ in interpreted])[:-1]
    noise_cov = _block_diagonal([cov for _, cov in interpreted])

    def measure(state: Array) -> Array:
        return np.concatenate([sensor.measure(state, step) for sensor, _ in group], axis=-1)

    def residual(value: Array, predicted: Array) -> Array:
        pairs = zip(
            group,
            np.split(value, sizes, axis=-1),
            np.split(predicted, sizes, axis=-1),
            strict=True,
        )
        return np.concatenate([sensor.residual(v, p) for (sensor, _), v, p in pairs], axis=-1)

    values = np.concatenate([value for value, _ in interpreted])
    gate = group[0][0].gate
    return update(belief, values, measure, noise_cov, points, residual=residual, gate=gate).belief


def _block_diagonal(blocks: list[Array]) -> Array:
    size = sum(len(block) for block in blocks)
    matrix = np.zeros((size, size))
    start = 0
    for block in blocks:
        stop = start + len(block)
        matrix[start:stop, start:stop] = block
        start = stop
    return matrix
