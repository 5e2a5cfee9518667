"""The two filters that frame every network: one that hears everything, and each node alone.

Both are computed after the run from what its sensors delivered, by the filter of the scenario, so
they see the same noise in every driver.

The filter that hears everything takes the readings of a step one by one, in the order of the nodes.
On linear models that equals one update with all of them. On target-tracking (20 nodes, 400 runs) it
was the best of the ways tried, beside all readings at once and iterated posterior linearisation:
docs/results.md has the figures.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from concord.filters.filter import Filter, begun, moments
from concord.filters.gaussian import Gaussian
from concord.filters.smoother import Backward, smooth, smooth_with_lags
from concord.nodes.rules.local_filter import (
    LocalFilters,
    Memory,
    SensorGroup,
    predict_to_step,
    update_with_readings,
    where,
)
from concord.scenarios.build import filter_of
from concord.scenarios.catalogue import definition_of
from concord.scenarios.moves import with_scripted_moves
from concord.scenarios.preparation import setup_of_run
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.setup import Setup


class BaselineContent(NamedTuple):
    """The belief of a baseline, what its filter has learnt, one entry for each sensor, and the
    belief as its filter has it, after a first step."""

    belief: Gaussian
    memory: tuple[Memory | None, ...] = ()
    kept: Gaussian | None = None

    def before(self, filter: Filter) -> Gaussian:
        """The belief as this filter has it."""
        return begun(filter, self.belief) if self.kept is None else self.kept


def _after(filter: Filter, belief: Gaussian, memory: tuple[Memory | None, ...]) -> BaselineContent:
    return BaselineContent(moments(filter, belief), memory, belief)


BaselineStep = Callable[[BaselineContent, int, np.ndarray, np.ndarray | None], BaselineContent]
"""(content of the step before, step, readings (N, r, d), control (p,)) -> content of the step."""


def centralised(setup: Setup, readings: np.ndarray, control: np.ndarray | None) -> Gaussian:
    """One filter that takes all readings (steps, N, r, d): mean (steps, n), cov (steps, n, n)."""
    return _alone(centralised_of_runs(setup, [setup.scenario.run], *_one_run(readings, control)))


def local_only(setup: Setup, readings: np.ndarray, control: np.ndarray | None) -> Gaussian:
    """Each node with its own readings alone: mean (steps, N, n), cov (steps, N, n, n)."""
    return _alone(local_only_of_runs(setup, [setup.scenario.run], *_one_run(readings, control)))


def centralised_of_runs(
    setup: Setup,
    runs: Sequence[int],
    readings: np.ndarray,
    control: np.ndarray | None,
    prior_mean: np.ndarray | None = None,
) -> Gaussian:
    """`centralised` in the runs of these numbers: readings (R, steps, N, r, d), control (R, steps,
    p); mean (R, steps, n), cov (R, steps, n, n).

    `prior_mean` (R, n) is drawn anew when left out, with the rest of each run's noise.
    """
    nodes = list(range(setup.scenario.nodes))
    if not filters_step_by_step(setup):
        return _one_by_one(setup, runs, nodes, readings, control)
    prior = priors_of_runs(setup, runs, prior_mean)
    return _through(prior, baseline_step(setup, nodes), readings, control)


def centralised_past(
    setup: Setup, filtered: Gaussian, control: np.ndarray | None, most: int
) -> Gaussian:
    """States of 0 to `most` steps ago, smoothed by one filter that hears everything.

    `filtered` is that of `centralised_of_runs`; control (R, steps, p). Returns mean (most + 1, R,
    steps, n) and covariance, NaN before the run.
    """
    history = Gaussian(*(np.moveaxis(values, 1, 0) for values in filtered))
    past = smooth_with_lags(history, _ways_back(setup, filtered, control), most)
    return Gaussian(*(np.moveaxis(values, 1, 2) for values in past))


def centralised_smoothed(setup: Setup, filtered: Gaussian, control: np.ndarray | None) -> Gaussian:
    """The states of a whole run given all its readings, by one smoother that hears everything.

    `filtered` (steps, n) is that of `centralised`; control (steps, p). The result has the same
    shape.
    """
    lanes = Gaussian(*(values[None] for values in filtered))
    driven = None if control is None else control[None]
    return smooth(filtered, [_alone_way(way) for way in _ways_back(setup, lanes, driven)])


def _alone_way(way: Backward) -> Backward:
    return Backward(_alone(way.predicted), way.gain[0])


def _ways_back(setup: Setup, filtered: Gaussian, control: np.ndarray | None) -> list[Backward]:
    """The ways from each step of beliefs (R, steps, n) to the one before it."""
    # Only here: most runs estimate no past states.
    from concord.nodes.rules.labelled.window_smoother import way_back

    model, own_filter = definition_of(setup.scenario).model(setup.scenario), filter_of(setup)
    return [
        way_back(
            Gaussian(filtered.mean[:, step - 1], filtered.cov[:, step - 1]),
            driven_into(control, step),
            step,
            model,
            own_filter,
        )
        for step in range(1, filtered.mean.shape[1])
    ]


def local_only_of_runs(
    setup: Setup,
    runs: Sequence[int],
    readings: np.ndarray,
    control: np.ndarray | None,
    prior_mean: np.ndarray | None = None,
) -> Gaussian:
    """`local_only` in the runs of these numbers: mean (R, steps, N, n), cov (R, steps, N, n, n).

    `prior_mean` as in `centralised_of_runs`.
    """
    nodes = range(setup.scenario.nodes)
    definition = definition_of(setup.scenario)
    if filters_step_by_step(setup) and definition.sensors is not None and readings.shape[-2] == 1:
        return _all_alone(setup, priors_of_runs(setup, runs, prior_mean), readings, control)
    if filters_step_by_step(setup):
        prior = priors_of_runs(setup, runs, prior_mean)
        alone = [_through(prior, baseline_step(setup, [node]), readings, control) for node in nodes]
    else:
        alone = [_one_by_one(setup, runs, [node], readings, control) for node in nodes]
    return Gaussian(
        np.stack([belief.mean for belief in alone], axis=2),
        np.stack([belief.cov for belief in alone], axis=2),
    )


def _all_alone(
    setup: Setup, prior: Gaussian, readings: np.ndarray, control: np.ndarray | None
) -> Gaussian:
    """Nodes that take one reading each a step at most, all at once."""
    scenario = with_scripted_moves(setup).scenario
    definition = definition_of(scenario)
    assert definition.sensors is not None, "the caller has looked"
    group = SensorGroup(slice(None), definition.sensors(scenario))
    filters = LocalFilters(definition.model(scenario), (group,), filter_of(setup))

    def advance(
        content: BaselineContent, step: int, delivered: np.ndarray, driven: np.ndarray | None
    ) -> BaselineContent:
        belief = content.before(filters.filter)
        if step > 0:
            belief, _ = filters.predict(belief, driven, step)
        found = filters.update(belief, delivered, step, content.memory)
        return _after(filters.filter, found.belief, found.memory)

    shape = (len(prior.mean), scenario.nodes)
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


def priors_of_runs(setup: Setup, runs: Sequence[int], mean: np.ndarray | None = None) -> Gaussian:
    """Where filters begin in the runs of these numbers: (R, n), (R, n, n).

    The mean is drawn where it is not given.
    """
    if mean is None:
        mean = np.array([setup_of_run(setup, run).prior_mean for run in runs])
    n = mean.shape[-1]
    return Gaussian(mean, np.broadcast_to(setup.prior_cov, (len(runs), n, n)))


def _through(
    belief: Gaussian, advance: BaselineStep, readings: np.ndarray, control: np.ndarray | None
) -> Gaussian:
    """Beliefs (R, steps, ...) after each step, of those (R, ...) before the first."""
    content = BaselineContent(belief)
    means, covs = [], []
    for step in range(readings.shape[1]):
        content = advance(content, step, readings[:, step], driven_into(control, step))
        means.append(content.belief.mean)
        covs.append(content.belief.cov)
    return Gaussian(np.stack(means, axis=1), np.stack(covs, axis=1))


def driven_into(control: np.ndarray | None, step: int) -> np.ndarray | None:
    """The control (R, p) into a step; None too where no node closed the loop yet."""
    driven = None if control is None else control[:, step]
    return None if driven is None or np.isnan(driven).all() else driven


def filters_step_by_step(setup: Setup) -> bool:
    """Whether `baseline_step` is the scenario's filter; other filters take a whole run at once."""
    definition = definition_of(setup.scenario)
    has_own = definition.baseline_filter or rule_of(setup.scenario).baseline_filter
    return definition.is_received or has_own is None


def _unknown(content: BaselineContent, *_: object) -> BaselineContent:
    """Return a belief of which nothing is known: there is no model."""
    return BaselineContent(Gaussian(*(np.full_like(one, np.nan) for one in content.belief)))


def baseline_step(setup: Setup, nodes: list[int]) -> BaselineStep:
    """One filter that takes the readings of these nodes, one step at a time.

    Contents, readings and control may have leading axes, one entry a run.
    """
    scenario, own_filter = with_scripted_moves(setup).scenario, filter_of(setup)
    definition = definition_of(scenario)
    if definition.is_received:
        return _unknown
    model = definition.model(scenario)
    each = [(node, definition.sensor(scenario, node)) for node in nodes]
    sensors = [(node, sensor) for node, sensor in each if sensor is not None]

    def advance(
        content: BaselineContent, step: int, delivered: np.ndarray, driven: np.ndarray | None
    ) -> BaselineContent:
        belief = content.before(own_filter)
        before = content.memory or (None,) * len(sensors)
        memory: tuple[Memory | None, ...] = ()
        if step > 0:
            moved, sound = predict_to_step(belief, driven, step, model, own_filter)
            belief = where(sound, moved, belief)
        for (node, sensor), known in zip(sensors, before, strict=True):
            readings = delivered[..., node, :, :]
            belief, learnt, _ = update_with_readings(
                belief, readings, step, sensor, own_filter, known
            )
            memory += learnt
        return _after(own_filter, belief, memory)

    return advance
