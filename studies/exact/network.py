"""A scenario as the exact engine needs it: rule, schedule and losses of a network whose plant is
linear, and the reasons why another one has no exact form."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import gcd
from typing import Any

import msgspec
import numpy as np

from concord.bus.schedule import Schedule
from concord.nodes.faults.losses import LinkState
from concord.nodes.lanes.batch import InBatch
from concord.nodes.lanes.links import Links, links_of, places
from concord.nodes.rules.belief_consensus import BeliefConsensus
from concord.nodes.rules.fresh_consensus import FreshConsensus
from concord.nodes.rules.local_filter import LocalFilters, Model
from concord.runtime.batched.build import batch_context, frames_of, lost_frames, without_array_form
from concord.scenarios.build import build_bus, filter_of
from concord.scenarios.catalogue import definition_of
from concord.scenarios.links import link_state
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioPlant
from concord.scenarios.setup import Setup, generator
from concord.scenarios.types.holds import Fading, Predicted, Raw
from concord.scenarios.types.rules import hold_of, number_of
from concord.studies.exact.averaged_errors import LinearNetwork
from concord.studies.exact.truth import (
    LinearTruth,
    NotExact,
    believed_transition,
    linear_truth,
    weighed_rows,
    with_bias,
)

KALMAN_FILTERS = ("ukf", "ckf", "srukf", "srckf", "ekf", "kf")
"""Filters that are the Kalman filter where plant and sensors are linear."""


@dataclass(frozen=True)
class ExactNetwork:
    """A network whose errors can be propagated; `setup` has the Kalman filter at its nodes.

    rule: all nodes in lanes. holds: whether a share of an earlier step can have a weight.
    follows: whether errors depend on the plant's state, because a filter believes another
    transition, or takes a share of an earlier step as it was.
    """

    setup: Setup
    rule: InBatch[Any, Any, Any]
    truth: LinearTruth
    links: Links
    schedule: Schedule
    holds: bool
    follows: bool

    @property
    def scenario(self) -> Scenario:
        return self.setup.scenario

    @cached_property
    def plant(self) -> ScenarioPlant:
        return definition_of(self.scenario).plant(self.scenario)

    @property
    def model(self) -> Model:
        return self.rule.filters.model

    @cached_property
    def period_steps(self) -> int:
        """Steps after which the slots repeat."""
        period = self.schedule.period
        return period // gcd(period, self.scenario.rounds)

    @cached_property
    def slot_links(self) -> np.ndarray:
        """One link (S,) of each held share: of a sender where all hear alike, else every link."""
        if not self.holds:
            return np.zeros(0, dtype=np.int64)
        if not self.links.perfect:
            return np.arange(len(self.links.sender))
        return np.unique(self.links.sender, return_index=True)[1]

    @cached_property
    def link_slots(self) -> np.ndarray:
        """The held share (E,) that each link reads."""
        if not self.links.perfect:
            return np.arange(len(self.links.sender))
        return np.unique(self.links.sender, return_inverse=True)[1]

    def groups(self, cycle: int) -> list[np.ndarray]:
        """Return which nodes (N,) send in each group of a cycle."""
        found = []
        for group in self.schedule.groups(cycle):
            sends = np.zeros(self.scenario.nodes, dtype=bool)
            sends[places(group.senders)] = True
            found.append(sends)
        return found

    def lost_in(self, patterns: Sequence[int]) -> Callable[[int, int], np.ndarray | None]:
        """Return the function of (step, cycle) that tells the frames lost by each link (P, E)."""
        if self.links.perfect:
            return lambda step, cycle: None
        states = [link_state(_of_run(self.setup, run)) for run in patterns]
        return lambda step, cycle: self._lost(states, step, cycle)

    def _lost(self, states: list[LinkState], step: int, cycle: int) -> np.ndarray:
        bus = build_bus(self.setup)
        return lost_frames(states, self.links, lambda c: frames_of(self.setup, bus, c), step, cycle)


def why_not(setup: Setup) -> str | None:
    """Return why a network has no exact covariances; None if it has."""
    try:
        exact_network(setup)
    except NotExact as error:
        return str(error)
    return None


def exact_network(setup: Setup) -> ExactNetwork:
    """Return the network of a setup for the exact engine.

    Raises:
        NotExact: naming what of the scenario has no exact form, and the cure.
    """
    scenario, definition = setup.scenario, definition_of(setup.scenario)
    _refuse(scenario)
    if scenario.filter.name != "kf":
        kalman = scenario.with_(filter="kf")
        setup = msgspec.structs.replace(setup, scenario=kalman)
    model, name = definition.model(scenario), scenario.name
    of_nodes = [definition.sensor(scenario, node) for node in range(scenario.nodes)]
    linear = with_bias(_linear_truth(setup), of_nodes)
    n = len(linear.F)
    sensors = [group.sensor for group in definition.sensor_groups(scenario)]
    if any(sensor.gate is not None for sensor in sensors):
        raise NotExact(f"{name} --exact: a gate refuses readings by their values")
    bus, perfect = build_bus(setup), link_state(setup).perfect
    if any(bus.schedule.contenders(cycle) for cycle in range(bus.schedule.period)):
        raise NotExact(
            f"--schedule {scenario.bus.schedule.name} --exact: nodes contend for slots with their "
            "estimates; use --schedule full, turns or written"
        )
    context = batch_context(setup, bus, links_of(setup.neighbours, perfect))
    filters = LocalFilters(model, context.filters.groups, filter_of(setup))
    plain = rule_of(setup.scenario).plain
    if plain is None:
        raise NotExact(f"rule {scenario.rule.name} --exact: it keeps more than beliefs; use runs")
    rule = plain(context._replace(filters=filters))
    if not isinstance(rule, InBatch) or not isinstance(rule.rule, BeliefConsensus | FreshConsensus):
        raise NotExact(f"rule {scenario.rule.name} --exact: it keeps more than beliefs; use runs")
    every = all(len(g.senders) == scenario.nodes for c in range(bus.schedule.period)
                for g in bus.schedule.groups(c))  # fmt: skip
    holds = isinstance(rule.rule, BeliefConsensus) and not (perfect and every)
    holds = holds and isinstance(hold_of(scenario.rule), Fading | Predicted | Raw)
    follows = not np.allclose(linear.F, believed_transition(model, n), rtol=1e-12, atol=1e-14)
    follows = follows or (holds and isinstance(hold_of(scenario.rule), Raw))
    if follows and _is_driven(scenario, n):
        raise NotExact(
            f"{name} --exact: its inputs move the state, and a wrong model makes errors of it; use "
            "runs"
        )
    if follows and definition.controller(scenario) is not None:
        raise NotExact(
            f"{name} --exact: its errors depend on the state, and a controller moves that by "
            "estimates; use --control open"
        )
    return ExactNetwork(setup, rule, linear, context.links, bus.schedule, holds, follows)


def _is_driven(scenario: Scenario, n: int) -> bool:
    """Whether something but noise moves the state zero in some step."""
    plant = definition_of(scenario).plant(scenario)
    none = np.zeros_like(plant.draw(partial(generator, scenario), 1).process[0])
    zero = np.zeros(n)
    return any(plant.advance(zero, None, none, step).any() for step in range(scenario.steps - 1))


def linear_network(setup: Setup) -> LinearNetwork:
    """Return a plant as the filters believe it, and what each node's readings tell of it.

    Raises:
        NotExact: the plant or a sensor is not linear, or its nodes are no sensors of one plant.
    """
    scenario, definition = setup.scenario, definition_of(setup.scenario)
    n = len(setup.prior_mean)
    if definition.wirings or len(setup.initial_state) != n:
        raise NotExact(f"scenario {scenario.name}: its nodes share no linear plant")
    linear, model = _linear_truth(setup), definition.model(scenario)
    weighed = weighed_rows(linear, definition.sensor_groups(scenario))
    of_nodes = weighed.reshape(n, scenario.nodes, -1).swapaxes(0, 1)
    information = of_nodes @ linear.H.reshape(scenario.nodes, -1, n)
    F = believed_transition(model, n)
    return LinearNetwork(F, model.process_noise_cov(0), information, np.array(setup.prior_cov))


def _linear_truth(setup: Setup) -> LinearTruth:
    scenario = setup.scenario
    plant = definition_of(scenario).plant(scenario)
    draws = plant.draw(partial(generator, scenario), 2)
    shape, noises = draws.measurement.shape[1:], draws.process.shape[-1]
    try:
        return linear_truth(plant, shape, noises, len(setup.prior_mean))
    except NotExact as error:
        raise NotExact(
            f"scenario {scenario.name}: {error}, and exact errors are those of linear plants; use "
            "--scenario oscillator, an own linear scenario, or runs"
        ) from None


def _refuse(scenario: Scenario) -> None:
    definition = definition_of(scenario)
    name = scenario.name
    if scenario.changes:
        raise NotExact("--changes with --exact: the network must stay as it is; use runs")
    if definition.wirings or definition.delivery or any(definition.late_steps(scenario)):
        raise NotExact(f"{name} --exact: its readings do not come to the nodes at once; use runs")
    if reason := definition.irregular(scenario):
        raise NotExact(f"{name} --exact: {reason}; use runs")
    if scenario.filter.name not in KALMAN_FILTERS:
        raise NotExact(
            f"--filter {scenario.filter.name} --exact: its gains depend on the readings; use "
            f"--filter {KALMAN_FILTERS[0]}"
        )
    if number_of(scenario.rule) != "float64":
        raise NotExact(
            f"--number {number_of(scenario.rule)} --exact: shares are rounded; use --number float64"
        )
    if definition.all_steps is not None:
        raise NotExact(f"{name} --exact: it has the readings of a log; use runs")
    if (lacking := without_array_form(scenario)) is not None:
        raise NotExact(f"{lacking} with --exact: it goes message by message alone; use runs")


def _of_run(setup: Setup, run: int) -> Setup:
    return msgspec.structs.replace(setup, scenario=setup.scenario.with_(run=run))
