"""The two filters that frame every network: one that hears everything, and each node alone.

Both are computed after the run from what its sensors delivered, by the same filter functions, so
they see the same noise in every driver.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.filters.ukf import predict, update
from concord.nodes.rules.local_filter import LocalFilters, Sensor, SensorGroup, update_with_readings
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import setup_of_run
from concord.scenarios.rules import rule_of
from concord.scenarios.setup import Setup

# An update inverts a matrix of all readings that it takes, so beyond so many they are taken batch
# by batch, and the cost grows with their number. On a linear plant that is the same; elsewhere each
# batch is linearised where those before have led.
READINGS_AT_ONCE = 200

BaselineStep = Callable[[Gaussian, int, np.ndarray, np.ndarray | None], Gaussian]
"""(belief of the step before, step, readings (N, r, d), control (p,)) -> belief of the step."""


def centralised(setup: Setup, readings: np.ndarray, control: np.ndarray | None) -> Gaussian:
    """One filter that takes all readings (steps, N, r, d): mean (steps, n), cov (steps, n, n)."""
    return _alone(centralised_of_runs(setup, [setup.scenario.run], *_one_run(readings, control)))


def local_only(setup: Setup, readings: np.ndarray, control: np.ndarray | None) -> Gaussian:
    """Each node with its own readings alone: mean (steps, N, n), cov (steps, N, n, n)."""
    return _alone(local_only_of_runs(setup, [setup.scenario.run], *_one_run(readings, control)))


def centralised_of_runs(
    setup: Setup, runs: Sequence[int], readings: np.ndarray, control: np.ndarray | None
) -> Gaussian:
    """`centralised` in the runs of these numbers: readings (R, steps, N, r, d), control (R, steps,
    p); mean (R, steps, n), cov (R, steps, n, n)."""
    nodes = list(range(setup.scenario.nodes))
    if not filters_step_by_step(setup):
        return _one_by_one(setup, runs, nodes, readings, control)
    return _stepwise(setup, runs, baseline_step(setup, nodes), readings, control)


def local_only_of_runs(
    setup: Setup, runs: Sequence[int], readings: np.ndarray, control: np.ndarray | None
) -> Gaussian:
    """`local_only` in the runs of these numbers: mean (R, steps, N, n), cov (R, steps, N, n, n)."""
    nodes = range(setup.scenario.nodes)
    definition = definition_of(setup.scenario)
    if filters_step_by_step(setup) and definition.sensors is not None and readings.shape[-2] == 1:
        return _all_alone(setup, runs, readings, control)
    alone = [
        _one_by_one(setup, runs, [node], readings, control)
        if not filters_step_by_step(setup)
        else _stepwise(setup, runs, baseline_step(setup, [node]), readings, control)
        for node in nodes
    ]
    return Gaussian(
        np.stack([belief.mean for belief in alone], axis=2),
        np.stack([belief.cov for belief in alone], axis=2),
    )


def _all_alone(
    setup: Setup, runs: Sequence[int], readings: np.ndarray, control: np.ndarray | None
) -> Gaussian:
    """Nodes that take one reading each a step at most, all at once."""
    definition, scenario = definition_of(setup.scenario), setup.scenario
    assert definition.sensors is not None, "the caller has looked"
    group = SensorGroup(slice(None), definition.sensors(scenario))
    points = scaled_unscented(len(setup.prior_mean))
    filters = LocalFilters(definition.model(scenario), (group,), points)

    def advance(
        belief: Gaussian, step: int, delivered: np.ndarray, driven: np.ndarray | None
    ) -> Gaussian:
        if step > 0:
            belief, _ = filters.predict(belief, driven, step)
        return filters.update(belief, delivered, step)[0]

    prior = _priors(setup, runs)
    shape = (len(runs), scenario.nodes)
    everywhere = Gaussian(
        np.broadcast_to(prior.mean[:, None], (*shape, *prior.mean.shape[1:])),
        np.broadcast_to(prior.cov[:, None], (*shape, *prior.cov.shape[1:])),
    )
    return _through(everywhere, advance, readings, control)


def _one_run(
    readings: np.ndarray, control: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    return readings[None], None if control is None else control[None]


def _alone(beliefs: Gaussian) -> Gaussian:
    return Gaussian(beliefs.mean[0], beliefs.cov[0])


def _one_by_one(
    setup: Setup,
    runs: Sequence[int],
    nodes: list[int],
    readings: np.ndarray,
    control: np.ndarray | None,
) -> Gaussian:
    """Filters that listen to a whole run at once, run by run."""
    definition = definition_of(setup.scenario)
    beliefs = []
    for place, run in enumerate(runs):
        own = setup_of_run(setup, run)
        if definition.baseline_filter is not None:
            beliefs.append(definition.baseline_filter(own, nodes, readings[place]))
        else:
            filter_of_rule = rule_of(setup.scenario).baseline_filter
            assert filter_of_rule is not None, "listens_step_by_step has looked"
            driven = None if control is None else control[place]
            beliefs.append(filter_of_rule(own, nodes, readings[place], driven))
    return Gaussian(
        np.stack([belief.mean for belief in beliefs]), np.stack([belief.cov for belief in beliefs])
    )


def _stepwise(
    setup: Setup,
    runs: Sequence[int],
    advance: BaselineStep,
    readings: np.ndarray,
    control: np.ndarray | None,
) -> Gaussian:
    return _through(_priors(setup, runs), advance, readings, control)


def _priors(setup: Setup, runs: Sequence[int]) -> Gaussian:
    """Where filters begin in the runs of these numbers: (R, n), (R, n, n)."""
    starts = [setup_of_run(setup, run) for run in runs]
    return Gaussian(
        np.array([start.prior_mean for start in starts]),
        np.array([start.prior_cov for start in starts]),
    )


def _through(
    belief: Gaussian, advance: BaselineStep, readings: np.ndarray, control: np.ndarray | None
) -> Gaussian:
    """Beliefs (R, steps, ...) after each step, of those (R, ...) before the first."""
    means, covs = [], []
    for step in range(readings.shape[1]):
        driven = None if control is None else control[:, step]
        if driven is not None and np.isnan(driven).all():
            # The node that closes the loop was not present yet.
            driven = None
        belief = advance(belief, step, readings[:, step], driven)
        means.append(belief.mean)
        covs.append(belief.cov)
    return Gaussian(np.stack(means, axis=1), np.stack(covs, axis=1))


def filters_step_by_step(setup: Setup) -> bool:
    """Whether `baseline_step` is the scenario's filter; other filters take a whole run at once."""
    definition = definition_of(setup.scenario)
    return definition.baseline_filter is None and rule_of(setup.scenario).baseline_filter is None


def baseline_step(setup: Setup, nodes: list[int]) -> BaselineStep:
    """One filter that takes the readings of these nodes, one step at a time.

    Beliefs, readings and control may have leading axes, one entry a run.
    """
    definition = definition_of(setup.scenario)
    model = definition.model(setup.scenario)
    points = scaled_unscented(len(setup.prior_mean))
    groups = _sensors(setup, nodes)

    def advance(
        belief: Gaussian, step: int, delivered: np.ndarray, driven: np.ndarray | None
    ) -> Gaussian:
        if step > 0:
            transition = partial(model.transition, control=driven, step=step - 1)
            belief = predict(belief, transition, model.process_noise_cov(step - 1), points)
        if all(sensor.gate is None for _, sensor in groups):
            return _together(belief, groups, delivered, step, points)
        # A gate judges each reading by itself.
        for node, sensor in groups:
            for one in np.moveaxis(delivered[..., node, :, :], -3, 0):
                belief, _ = update_with_readings(belief, one, step, sensor, points)
        return belief

    return advance


def _sensors(setup: Setup, nodes: list[int]) -> list[SensorGroup]:
    definition, scenario = definition_of(setup.scenario), setup.scenario
    if definition.sensors is not None and len(nodes) == scenario.nodes:
        return [SensorGroup(slice(None), definition.sensors(scenario))]
    each = ((node, definition.sensor(scenario, node)) for node in nodes)
    return [SensorGroup(slice(i, i + 1), sensor) for i, sensor in each if sensor is not None]


class _Block(NamedTuple):
    """One reading of each of some nodes that share a sensor value: values (..., M, m) with noise
    covariances (..., M, m, m), of
    those `which` (..., M) of the `nodes` that took most readings."""

    sensor: Sensor
    nodes: int
    which: np.ndarray
    values: np.ndarray
    noise_cov: np.ndarray

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return the readings of their sensors at points (S, ..., n): (S, ..., M, m)."""
        every = self.sensor.measure(state[..., None, :], step)
        # Sensors that are all alike deliver one value for all nodes.
        every = np.broadcast_to(every, (*every.shape[:-2], self.nodes, every.shape[-1]))
        return np.take_along_axis(every, self.which[None, ..., None], axis=-2)


def _together(
    belief: Gaussian,
    groups: list[SensorGroup],
    delivered: np.ndarray,
    step: int,
    points: SigmaPointRule,
) -> Gaussian:
    """All readings of a step (..., N, r, d), as many at once as can be; those that were not taken
    are left out."""
    blocks = [
        block
        for nodes, sensor in groups
        for place in range(delivered.shape[-2])
        for block in _parts(_block(sensor, delivered[..., nodes, place, :]))
    ]
    for batch in _batches(blocks):
        belief = _taken(belief, batch, step, points)
    return belief


def _parts(block: _Block) -> Iterator[_Block]:
    """A block in parts of as many readings as are taken at once; nothing of an empty one."""
    for first in range(0, block.which.shape[-1], READINGS_AT_ONCE):
        some = slice(first, first + READINGS_AT_ONCE)
        yield block._replace(
            which=block.which[..., some],
            values=block.values[..., some, :],
            noise_cov=block.noise_cov[..., some, :, :],
        )


def _batches(blocks: Sequence[_Block]) -> Iterator[list[_Block]]:
    """Blocks in their order, of as many readings together as are taken at once."""
    batch: list[_Block] = []
    count = 0
    for block in blocks:
        if batch and count + block.which.shape[-1] > READINGS_AT_ONCE:
            yield batch
            batch, count = [], 0
        batch.append(block)
        count += block.which.shape[-1]
    if batch:
        yield batch


def _taken(belief: Gaussian, blocks: list[_Block], step: int, points: SigmaPointRule) -> Gaussian:
    """The belief after these readings, at once."""
    sizes = [int(np.prod(block.values.shape[-2:])) for block in blocks]

    def measure(state: np.ndarray) -> np.ndarray:
        return np.concatenate([_flat(block.measure(state, step)) for block in blocks], axis=-1)

    def residual(value: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        ends = np.cumsum(sizes)[:-1]
        pairs = zip(blocks, *(np.split(x, ends, axis=-1) for x in (value, predicted)), strict=True)
        return np.concatenate([_difference(*values) for values in pairs], axis=-1)

    values = np.concatenate([_flat(block.values) for block in blocks], axis=-1)
    noise_cov = _block_diagonal([block.noise_cov for block in blocks])
    return update(belief, values, measure, noise_cov, points, residual=residual).belief


def _block(sensor: Sensor, delivered: np.ndarray) -> _Block:
    values, noise_cov = sensor.interpret(delivered)
    taken = np.logical_not(np.isnan(values).all(axis=-1))
    most = int(taken.sum(axis=-1).max())
    which = np.argsort(~taken, axis=-1, kind="stable")[..., :most]
    noise_cov = np.broadcast_to(noise_cov, (*values.shape, values.shape[-1]))
    return _Block(
        sensor,
        values.shape[-2],
        which,
        np.take_along_axis(values, which[..., None], axis=-2),
        np.take_along_axis(noise_cov, which[..., None, None], axis=-3),
    )


def _difference(block: _Block, value: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    shape = block.values.shape[-2:]
    pair = (values.reshape(*values.shape[:-1], *shape) for values in (value, predicted))
    return _flat(block.sensor.residual(*pair))


def _flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(*values.shape[:-2], -1)


def _block_diagonal(stacks: list[np.ndarray]) -> np.ndarray:
    """Matrices (..., M, m, m) as the blocks of one (..., sum M m, sum M m)."""
    size = sum(stack.shape[-3] * stack.shape[-1] for stack in stacks)
    matrix = np.zeros((*stacks[0].shape[:-3], size, size))
    start = 0
    for stack in stacks:
        for block in np.moveaxis(stack, -3, 0):
            stop = start + block.shape[-1]
            matrix[..., start:stop, start:stop] = block
            start = stop
    return matrix
