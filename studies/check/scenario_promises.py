"""Promises of a scenario: its models, its noise, and the filter that hears every sensor."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import msgspec
import numpy as np

from concord.nodes.rules.local_filter import Sensor
from concord.results.figures.figure_table import computed
from concord.results.figures.intervals import positive_mean_t
from concord.results.figures.run_frame import without_bound
from concord.results.figures.run_view import RunView
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.catalogue import definition_of
from concord.scenarios.observability import observability, rank
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import generator
from concord.studies.check.promise import Promise, PromiseResult, raised
from concord.studies.check.rule_promises import check_agreement
from concord.studies.monte_carlo.simulate import simulate

_LANES = (2, 3)
_ROUNDING = 1e-9
_AGREED_STEPS = 15
_DRAWN_STEPS = 5
# The filter may be off by so much of its ANEES on a nonlinear plant.
_APPROXIMATION = 0.1
# A consistent filter fails with a chance of one in ten thousand.
_CONFIDENCE = 1 - 2e-4
_TOO_WIDE = 3.0
# An interval needs many runs; the number of one case asks for these.
_RUNS = 100


def checked_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario if it is one of sensors that observe one plant.

    Raises:
        ValueError: it is not, or it cannot run.
    """
    prepare(scenario)
    if definition_of(scenario).wirings:
        raise ValueError(
            f"scenario {scenario.name}: its nodes are the sensors and the estimator of a "
            "measurement bus; check a scenario whose nodes observe one plant"
        )
    return scenario


# --- models --------------------------------------------------------------------------------------


def _transition_keeps_lanes(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    model = definition_of(scenario).model(scenario)
    return _keeps_lanes(scenario, cases, {"f": partial(model.transition, control=None, step=0)})


def _sensors_keep_lanes(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    functions = {
        f"h of node {node}": partial(sensor.measure, step=0) for node, sensor in _sensors(scenario)
    }
    return _keeps_lanes(scenario, cases, functions)


def _keeps_lanes(
    scenario: Scenario,
    cases: Sequence[int],
    functions: dict[str, Callable[[np.ndarray], np.ndarray]],
) -> PromiseResult:
    """Compare each function of states (R, N, n) from the prior with itself, lane by lane."""
    for number in cases:
        states = _states_of_prior(scenario, number)
        for name, function in functions.items():
            if fault := _lane_fault(function, states):
                return PromiseResult("BROKEN", f"case {number}: {name} {fault}", number)
    return PromiseResult("holds", f"{len(functions)} functions, {len(cases)} cases")


def _lane_fault(function: Callable[[np.ndarray], np.ndarray], states: np.ndarray) -> str:
    try:
        together = np.asarray(function(states))
        alone = [np.asarray(function(states[lane])) for lane in np.ndindex(_LANES)]
    except Exception as error:  # a user's function may raise anything
        return raised(error)
    if together.shape != (*_LANES, *alone[0].shape):
        return f"turns states {states.shape} into {together.shape}, one state into {alone[0].shape}"
    for lane, own in zip(np.ndindex(_LANES), alone, strict=True):
        if not np.allclose(together[lane], own, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True):
            among = together[lane].tolist()
            return f"of state {states[lane].tolist()} is {own.tolist()}, and among others {among}"
    return ""


def _states_of_prior(scenario: Scenario, number: int) -> np.ndarray:
    """Draw states (R, N, n) from the law of the first state."""
    setup = prepare(scenario)
    factor = np.linalg.cholesky(np.array(setup.prior_cov))
    stream = np.random.default_rng(np.random.SeedSequence(number))
    white = stream.standard_normal((*_LANES, len(setup.prior_mean)))
    return np.array(setup.prior_mean) + white @ factor.T


def _sensors(scenario: Scenario) -> Iterator[tuple[int, Sensor]]:
    definition = definition_of(scenario)
    for node in range(scenario.nodes):
        if (sensor := definition.sensor(scenario, node)) is not None:
            yield node, sensor


# --- noise ---------------------------------------------------------------------------------------


def _noise_is_a_covariance(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    definition, setup = definition_of(scenario), prepare(scenario)
    plant = definition.plant(scenario)
    readings = plant.observe(
        np.array(setup.initial_state, dtype=float),
        plant.draw(partial(generator, scenario), 1).measurement[0],
        0,
    )
    found = {
        "the prior": np.array(setup.prior_cov),
        "the process noise": np.asarray(definition.model(scenario).process_noise_cov(0)),
    }
    for node, sensor in _sensors(scenario):
        noise = sensor.interpret(readings[node])[1][np.isfinite(readings[node]).any(axis=-1)]
        found[f"the noise of node {node}"] = noise
    for name, covs in found.items():
        if fault := _covariance_fault(covs):
            return PromiseResult("BROKEN", f"{name} {fault}")
    return PromiseResult("holds", f"{len(found)} covariances")


def _covariance_fault(covs: np.ndarray) -> str:
    """Return why matrices (..., m, m) are no covariances; an infinite variance says nothing."""
    known = np.where(np.isfinite(covs), covs, 0.0)
    if np.isnan(covs).any():
        return "has NaN"
    if not np.allclose(known, known.mT, rtol=_ROUNDING):
        return "is not symmetric"
    eigenvalues = np.linalg.eigvalsh(known)
    if eigenvalues.size and eigenvalues.min() < -_ROUNDING * np.abs(eigenvalues).max():
        return f"has an eigenvalue of {eigenvalues.min():.3g}"
    return ""


def _draws_of_a_node_are_its_own(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    more, _ = scenario.with_known(nodes=scenario.nodes + 1)
    try:
        plant = definition_of(more).plant(more)
        definition_of(more).check(more)
    except ValueError as refusal:
        return PromiseResult("skipped", str(refusal))
    for number in cases:
        here, there = (msgspec.structs.replace(one, seed=number) for one in (scenario, more))
        own = definition_of(here).plant(here).draw(partial(generator, here), _DRAWN_STEPS)
        other = plant.draw(partial(generator, there), _DRAWN_STEPS)
        same = {
            "initial": np.array_equal(own.initial, other.initial),
            "process": np.array_equal(own.process, other.process),
            "measurement": np.array_equal(own.measurement, other.measurement[:, : scenario.nodes]),
        }
        for name, equal in same.items():
            if not equal:
                seen = f"case {number}: {name} noise differs with {more.nodes} nodes"
                return PromiseResult("BROKEN", seen, number)
    return PromiseResult("holds", f"{len(cases)} seeds, {scenario.nodes} and {more.nodes} nodes")


# --- runs ----------------------------------------------------------------------------------------


def _drivers_agree(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    steps = min(scenario.steps, _AGREED_STEPS)
    return check_agreement(msgspec.structs.replace(scenario, steps=steps, seed=cases[0]))


def _one_filter_is_consistent(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    setup = prepare(msgspec.structs.replace(scenario, run=0))
    runs = range(len(cases) if len(cases) > 1 else _RUNS)
    simulated = simulate(setup, runs)
    assert simulated.readings is not None, "they are kept"
    belief = centralised_of_runs(setup, list(runs), simulated.readings, simulated.control)
    view = RunView(simulated, without_bound(belief))
    if np.isinf(simulated.truth).any() or view.failed.any():
        first = int(np.isinf(simulated.truth).any(axis=(0, 2)).argmax())
        seen = f"the truth is not finite from step {first} on" if first else "filters failed"
        return PromiseResult("BROKEN", f"{seen}, in {int(view.failed.sum())} of {len(runs)} runs")
    (anees,) = computed(view, ("anees_centralised",)).values()
    found = positive_mean_t(anees, _CONFIDENCE)
    if np.isnan(found.value):
        return PromiseResult("skipped", "no truth is known, or the estimates are sets")
    seen = f"ANEES {found.value:.3g} ({found.low:.3g} to {found.high:.3g}), {len(runs)} runs"
    words = ["--promise", "centralised", "--cases", str(len(runs))]
    again = shlex.join(["concord", "check", scenario.name, *words])
    if found.low > 1 + _APPROXIMATION:
        return PromiseResult("BROKEN", f"{seen}: errors are larger than believed", again=again)
    if not found.high / found.low < _TOO_WIDE:
        return PromiseResult("note", f"undecided: {seen}; use more --cases", again=again)
    if found.high < 1 - _APPROXIMATION:
        return PromiseResult("note", f"{seen}: errors are smaller than believed", again=again)
    return PromiseResult("holds", seen)


def _readings_see_the_plant(scenario: Scenario, cases: Sequence[int]) -> PromiseResult:
    try:
        found = observability(prepare(scenario))
    except ValueError as refusal:
        return PromiseResult("skipped", str(refusal))
    joint = found.gramian.sum(axis=0)
    seen, states = rank(joint, joint), len(joint)
    says = f"all nodes together see {seen} of {states} directions in {found.steps} steps"
    blind = f"; {len(found.blind)} nodes are blind" if found.blind else ""
    return PromiseResult("holds" if seen == states else "note", says + blind)


SCENARIO_PROMISES: tuple[Promise[Scenario], ...] = (
    Promise("transition", "f keeps the lanes of states", _transition_keeps_lanes),
    Promise("sensors", "h keeps the lanes of states", _sensors_keep_lanes),
    Promise("noise", "Q, R and the prior are covariances", _noise_is_a_covariance),
    Promise("draws", "noise does not depend on other nodes", _draws_of_a_node_are_its_own),
    Promise("agreement", "all drivers give the same estimates", _drivers_agree),
    Promise("centralised", "one filter of all readings is consistent", _one_filter_is_consistent),
    Promise("observable", "the sensors see every state", _readings_see_the_plant),
)
