"""The promise of a rule about random networks: under random faults their beliefs stay sound.

A belief must be finite, with a covariance that is positive definite. A consistent rule also covers
its errors. Where the filters know the plant exactly, no node is surer than the Kalman filter with
every reading: a covariance of counted-twice information is too small in the very step.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from concord.results.figures.posterior_bound import Truths, posterior_bound
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.plants import noise_of
from concord.scenarios.types.rules import number_of
from concord.studies.check.drawn_networks import EXACT_PLANTS, possible_networks

# An error beyond this has a chance of 2e-12: a thousand networks judge half a million errors.
IMPROBABLE = 2e-12
SET_TOLERANCE = 1e-6
_STEPS, _CALM_STEP = 20, 14


def draw_network(number: int, rule: str) -> Scenario:
    """Return the network of a number with this rule, and with faults until a calm end.

    Raises:
        ValueError: no network that was drawn can run the rule.
    """
    refusal = ValueError("no network was drawn")
    for _, generator, drawn in possible_networks(number):
        try:
            scenario, _ = drawn.with_known(rule=rule, steps=_STEPS)
            links = prepare(scenario, tries_rule=False).neighbours
            scenario, _ = scenario.with_known(changes=_changes(generator, links))
            prepare(scenario, tries_rule=False)
        except ValueError as error:
            refusal = error
        else:
            return scenario
    raise refusal


def _changes(
    generator: np.random.Generator, neighbours: Sequence[Sequence[int]]
) -> tuple[str, ...]:
    """Some of: lost frames, a death with its return, a cut link, a partition."""
    nodes = len(neighbours)
    dead, receiver = (int(node) for node in generator.integers(nodes, size=2))
    died, returned = sorted(generator.choice(range(1, _CALM_STEP), size=2, replace=False).tolist())
    lost, cut, parted = generator.integers(1, _CALM_STEP, size=3).tolist()
    side = sorted(generator.permutation(nodes)[: 1 + int(generator.integers(nodes - 1))].tolist())
    several = [
        (f"{lost} loss {generator.uniform(0.05, 0.9):.2f}",),
        (f"{died} kill {dead}", f"{returned} restart {dead}"),
        tuple(f"{cut} cut {sender} {receiver} one-way" for sender in neighbours[receiver][:1]),
        (f"{parted} partition {' '.join(map(str, side))}",),
    ]
    lines = [line for words in several if generator.random() < 0.5 for line in words]
    return (*sorted(lines, key=lambda line: int(line.split()[0])), f"{_CALM_STEP} calm")


def network_fault(scenario: Scenario, consistent: bool) -> str:
    """Return what is wrong with the beliefs of a network; "" for nothing."""
    setup = prepare(scenario)
    trace = read_trace(setup, in_memory(setup))
    for step, node in np.ndindex(trace.steps, scenario.nodes):
        is_in = trace.history.is_in(node, step)
        if is_in and (seen := belief_fault(trace.mean[step, node], trace.cov[step, node])):
            return f"node {node} in step {step}: {seen}"
    is_known = noise_of(scenario.plant) == "matched" and flat(scenario).get("hold") != "raw"
    return _consistency_fault(setup, trace) if consistent and is_known else ""


def belief_fault(mean: np.ndarray, cov: np.ndarray) -> str:
    """Return why a mean (n,) and a covariance (n, n) are no belief; "" if they are one."""
    if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        return f"the belief is not finite, mean {mean.tolist()}"
    try:
        np.linalg.cholesky(cov)
    except np.linalg.LinAlgError:
        return f"the covariance has an eigenvalue of {np.linalg.eigvalsh(cov).min():.3g}"
    return ""


def _consistency_fault(setup: Setup, trace: Trace) -> str:
    scenario = setup.scenario
    is_set, is_exact = rule_of(scenario).set_valued, scenario.name in EXACT_PLANTS
    if not (is_set or is_exact):
        return ""
    most = 1 + SET_TOLERANCE if is_set else float(chdtri(trace.mean.shape[-1], IMPROBABLE))
    errors = squares(trace.mean - trace.truth[:, None], trace.cov)
    step, node = np.unravel_index(np.nanargmax(errors), errors.shape)
    if errors[step, node] > most:
        found = f"{errors[step, node]:.4g} squared, at most {most:.4g}"
        return f"node {node} in step {step} errs by {found}"
    return "" if is_set else overconfidence(setup, trace.truth, trace.readings, trace.cov)


def squares(errors: np.ndarray, covs: np.ndarray) -> np.ndarray:
    """e' P^-1 e (...) of errors (..., n); NaN where one is."""
    there = np.isfinite(errors).all(axis=-1) & np.isfinite(covs).all(axis=(-1, -2))
    found = np.full(there.shape, np.nan)
    solved = np.linalg.solve(covs[there], errors[there][..., None])[..., 0]
    found[there] = (errors[there] * solved).sum(axis=-1)
    return found


def overconfidence(setup: Setup, truth: np.ndarray, readings: np.ndarray, covs: np.ndarray) -> str:
    """Return which covariance (steps, N, n, n) is smaller, in some direction, than that of the
    Kalman filter with every reading (steps, N, r, d); "" for none."""
    scenario, definition = setup.scenario, definition_of(setup.scenario)
    bound = posterior_bound(
        # The bound of a linear plant depends on which readings there are, and on no control.
        Truths(truth[None], readings[None], None),
        np.array(setup.prior_cov),
        definition.model(scenario),
        definition.sensor_groups(scenario),
    )
    # A node that is out of the network has no belief.
    covs = np.where(np.isnan(covs), bound[:, None], covs)
    whitener = np.linalg.inv(np.linalg.cholesky(bound))[:, None]
    share = np.linalg.eigvalsh(whitener @ covs @ whitener.mT)[..., 0]
    step, node = np.unravel_index(np.argmin(share), share.shape)
    # Differences and inverses on both sides, and numbers of single length on the bus.
    rounding = 1e-3 if number_of(scenario.rule) == "float32" else 1e-6
    if share[step, node] >= 1 - rounding:
        return ""
    return f"node {node} in step {step} believes {share[step, node]:.6g} of the least variance"
