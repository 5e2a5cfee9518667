"""Observability of the plant by all nodes together, along the plant's own trajectory.

The plant runs undisturbed by filters through some steps of the scenario's own noise. Model and
sensors are linearised along the trajectory. The Gramian sums the information of the readings that
really came about the first state (Kalman 1960; local observability of a nonlinear plant: Krener,
Ide 2009). The state is scaled by the prior's standard deviations and each reading by its noise, so
that a direction is seen as well as the readings tell more of it than the prior did.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.nodes.messages import from_wire
from concord.nodes.rules.local_filter import Sensor
from concord.scenarios.catalogue import definition_of
from concord.scenarios.setup import Setup, generator

# A direction with less information than this fraction of the best seen one is rounding.
_RANK_TOLERANCE = 1e-13
# Numerical derivatives look this part of a prior standard deviation to each side.
_DIFFERENCE = 1e-3


class Observability(NamedTuple):
    """Information of the readings about n states in `steps` steps.

    gramian: per node (N, n, n), in units of prior information; states: their names; blind: nodes
    that saw nothing at all.
    """

    gramian: np.ndarray
    states: tuple[str, ...]
    blind: tuple[int, ...]
    steps: int


def observability(setup: Setup, most_steps: int = 60) -> Observability:
    """Return the observability of a setup's plant by its nodes.

    Raises:
        ValueError: for a scenario whose nodes are no sensors of one plant (a measurement bus), or
            whose plant keeps another state than its filters.
    """
    scenario = setup.scenario
    definition = definition_of(scenario)
    n = len(setup.prior_mean)
    if definition.wirings or len(setup.initial_state) != n:
        raise ValueError(
            f"scenario {scenario.name}: observability is linearised along the plant's own state, "
            "which its filters do not share; leave --scenario out"
        )
    plant, model = definition.plant(scenario), definition.model(scenario)
    sensors = [definition.sensor(scenario, node) for node in range(scenario.nodes)]
    steps = min(scenario.steps, most_steps)
    draws = plant.draw(partial(generator, scenario), steps)
    state = from_wire(setup.initial_state)
    scale = np.sqrt(np.diag(np.array(setup.prior_cov)))
    ahead = np.diag(scale)  # d x_k / d x_0, in prior standard deviations
    gramian = np.zeros((scenario.nodes, n, n))
    seen = np.zeros(scenario.nodes, dtype=bool)
    for step in range(steps):
        delivered = plant.observe(state, draws.measurement[step], step)
        for node in np.flatnonzero(np.isfinite(delivered).any(axis=(-1, -2))):
            sensor = sensors[node]
            if sensor is None:
                continue
            seen[node] = True
            for reading in delivered[node]:
                gramian[node] += told(sensor, reading, state, scale, ahead, step)
        move = partial(model.transition, control=None, step=step)
        ahead = jacobian(move, state, scale, np.subtract) @ ahead
        state = plant.advance(state, None, draws.process[step], step)
    blind = tuple(np.flatnonzero(~seen).tolist())
    return Observability(gramian, plant.state_names, blind, steps)


def rank(gramian: np.ndarray, joint: np.ndarray) -> int:
    """How many directions a Gramian (n, n) sees, beside the rounding of the `joint` one (n, n)."""
    least = _RANK_TOLERANCE * max(float(np.linalg.eigvalsh(joint)[-1]), 1e-300)
    return int((np.linalg.eigvalsh(gramian) > least).sum())


def remaining(gramian: np.ndarray) -> np.ndarray:
    """Return the fraction of each state's prior deviation (n,) left after all readings."""
    return np.sqrt(np.diag(np.linalg.inv(np.eye(len(gramian)) + gramian)))


def jacobian(
    function: Callable[[np.ndarray], np.ndarray],
    point: np.ndarray,
    scale: np.ndarray,
    difference: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Derivative (m, n) of `function` at `point` (n,), by central differences."""
    step = _DIFFERENCE * scale
    sides = difference(function(point + np.diag(step)), function(point - np.diag(step)))
    return (sides / (2 * step)[:, None]).T


def told(
    sensor: Sensor,
    reading: np.ndarray,
    state: np.ndarray,
    scale: np.ndarray,
    ahead: np.ndarray,
    step: int,
) -> np.ndarray:
    """Return the information (n, n) of one reading (d,) about the first state.

    `ahead` (n, n) is the derivative of `state` to the first one.
    """
    if np.isnan(reading).all():
        return np.zeros((len(state), len(state)))
    _, noise_cov = sensor.interpret(reading)
    variance = np.diag(noise_cov)
    taken = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    measure = partial(sensor.measure, step=step)
    rows = jacobian(measure, state, scale, sensor.residual) @ ahead
    rows = np.where(np.isfinite(rows), rows, 0.0)[taken]
    return np.asarray(rows.T @ np.linalg.solve(noise_cov[taken][:, taken], rows), dtype=float)
