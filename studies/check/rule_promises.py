"""Promises of a fusion rule: about beliefs, and about networks that use it."""

import shlex
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np

from concord.filters.fusion.averaging import Directly
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.belief_consensus import BeliefConsensus
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_node
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.rule_table.rules_of_beliefs import Average
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import in_options, scenario_with_known
from concord.scenarios.setup import Setup
from concord.studies.agree import agreement
from concord.studies.check.belief_promises import (
    BELIEF_PROMISES,
    BeliefPromise,
    with_shapes_checked,
)
from concord.studies.check.neighbourhoods import Neighbourhood, draw_neighbourhood
from concord.studies.check.network_promise import draw_network, network_fault
from concord.studies.check.promise import Promise, PromiseResult, fault_of, raised
from concord.studies.check.shrinking import shrink, smaller_networks
from concord.studies.sweep.workers import Engine

_LOSS = 0.3
_NETWORKS = (
    {"scenario": "oscillator", "nodes": 6, "graph": "complete", "rounds": 2, "steps": 15},
    {"scenario": "oscillator", "nodes": 6, "graph": "complete", "rounds": 1, "steps": 15},
    {"scenario": "liu2021-network", "steps": 15},
)


class CheckedRule(NamedTuple):
    """A rule that is checked.

    Attributes:
        name: as the command line has it.
        scenario: a small network with this rule.
        average: the rule as a function of beliefs; None for a rule that exchanges anything else.
        consistent: the rule claims that its covariance covers the error.
        engine: computes the random networks.
    """

    name: str
    scenario: Scenario
    average: Average | None
    consistent: bool
    engine: Engine


def checked_rule(name: str, consistent: bool, engine: Engine) -> CheckedRule:
    """Return a rule by its name or its place in a file.

    Raises:
        ValueError: no small network can run it.
    """
    refusals = []
    for options in _NETWORKS:
        try:
            setup = prepare(scenario_with_known(**options, rule=name)[0], tries_rule=False)
        except ValueError as refusal:
            refusals.append(refusal)
            continue
        claims = consistent and rule_of(setup.scenario).consistent
        return CheckedRule(name, setup.scenario, _average(setup), claims, engine)
    raise refusals[0]


def _average(setup: Setup) -> Average | None:
    estimator = build_node(setup, 0).estimator
    if not (isinstance(estimator, AtNode) and isinstance(estimator.rule, BeliefConsensus)):
        return None
    averaged = estimator.rule.average
    if isinstance(averaged, Directly):
        return averaged.of

    def average(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
        mean, cov = beliefs
        own = Gaussian(mean[..., 0, :], cov[..., 0, :, :])
        others = Gaussian(mean[..., 1:, :], cov[..., 1:, :, :])
        return averaged.fuse(own, others, weights, False).belief

    return average


# --- about beliefs -------------------------------------------------------------------------------


def _check_beliefs(
    promise: BeliefPromise, rule: CheckedRule, cases: Sequence[int]
) -> PromiseResult:
    """Find the first case that breaks a promise, with the fewest states, then neighbours."""
    if rule.average is None:
        return PromiseResult("skipped", "the rule exchanges something other than beliefs")
    seen = partial(_seen, promise, rule.average)
    for number in cases:
        if seen(drawn := draw_neighbourhood(number)):
            smallest = _smallest(drawn, promise.fewest, seen)
            claimed = promise.claimed == "always" or (
                promise.claimed == "consistent" and rule.consistent
            )
            size = f"neighbours {smallest.neighbours}, states {smallest.states}"
            return PromiseResult(
                "BROKEN" if claimed else "note",
                f"case {number}, {size}: {seen(smallest)}",
                number,
                values=smallest.values(),
            )
    return PromiseResult("holds", f"{len(cases)} neighbourhoods")


def _seen(promise: BeliefPromise, average: Average, case: Neighbourhood) -> str:
    if case.neighbours < promise.fewest:
        return ""
    return fault_of(partial(promise.seen, with_shapes_checked(average), case))


def _smallest(
    case: Neighbourhood, fewest: int, seen: Callable[[Neighbourhood], str]
) -> Neighbourhood:
    for states in range(1, case.states + 1):
        for neighbours in range(fewest, case.neighbours + 1):
            if seen(smaller := case.cut(neighbours, states)):
                return smaller
    return case


# --- about networks ------------------------------------------------------------------------------


def _survives_loss(rule: CheckedRule, cases: Sequence[int]) -> PromiseResult:
    for seed in cases[:3]:
        scenario = msgspec.structs.replace(rule.scenario, seed=seed)
        scenario, _ = scenario.with_known(loss=_LOSS)
        try:
            setup = prepare(scenario)
        except ValueError as refusal:
            return PromiseResult("skipped", str(refusal))
        try:
            trace = read_trace(setup, in_memory(setup))
            finite = np.isfinite(trace.mean).all() and np.isfinite(trace.cov).all()
            seen = "" if finite else "a belief is not finite"
        except Exception as error:  # a user's function may raise anything
            seen = raised(error)
        if seen:
            return PromiseResult("BROKEN", f"seed {seed}: {seen}", seed, _command("run", scenario))
    return PromiseResult("holds", f"{len(cases[:3])} runs, finite beliefs")


def check_agreement(scenario: Scenario) -> PromiseResult:
    """Run a scenario in every driver."""
    again = _command("agree", scenario)
    try:
        found = agreement(prepare(scenario))
    except Exception as error:  # a user's function may raise anything
        return PromiseResult("BROKEN", raised(error), again=again)
    for one in found.differences:
        seen = f"{one.driver} differs in {one.quantity} at {tuple(one.index)}, step first"
        return PromiseResult("BROKEN", f"{seen}: {one.value!r}, not {one.reference!r}", again=again)
    drivers = [*found.drivers, *["batched"] * found.near]
    return PromiseResult(
        "holds", f"{', '.join(drivers)}: {scenario.nodes} nodes, {scenario.steps} steps"
    )


def _stands_random_networks(rule: CheckedRule, cases: Sequence[int]) -> PromiseResult:
    found = dict(rule.engine(partial(_seen_in_network, rule.name, rule.consistent), cases))
    for place, number in enumerate(cases):
        if found[place]:
            smallest = shrink(
                draw_network(number, rule.name),
                smaller_networks,
                partial(_breaks_too, rule),
            )
            size = f"{smallest.nodes} nodes, {smallest.steps} steps"
            seen = _fault_of_network(smallest, rule.consistent)
            again = _command("run", smallest)
            return PromiseResult("BROKEN", f"case {number}, {size}: {seen}", number, again)
    return PromiseResult("holds", f"{len(cases)} networks under random faults")


def _seen_in_network(name: str, consistent: bool, number: int) -> str:
    return _fault_of_network(draw_network(number, name), consistent)


def _breaks_too(rule: CheckedRule, scenario: Scenario) -> bool:
    is_same = scenario.rule.name == rule.name
    return is_same and bool(_fault_of_network(scenario, rule.consistent))


def _fault_of_network(scenario: Scenario, consistent: bool) -> str:
    return fault_of(partial(network_fault, scenario, consistent))


def _command(command: str, scenario: Scenario) -> str:
    options = in_options(scenario)
    return shlex.join(["concord", command, "--scenario", scenario.name, *options])


AGREEMENT: Promise[Any] = Promise(
    "agreement",
    "all drivers give the same estimates",
    lambda checked, _: check_agreement(checked.scenario),
)
RULE_PROMISES: tuple[Promise[CheckedRule], ...] = (
    *(Promise(one.name, one.says, partial(_check_beliefs, one)) for one in BELIEF_PROMISES),
    Promise("loss", f"{_LOSS:.0%} loss leaves finite beliefs", _survives_loss),
    AGREEMENT,
    Promise("networks", "random networks break no invariant", _stands_random_networks),
)
