"""The posterior bound against the Kalman covariance, the joint information matrix, and a filter."""

from functools import partial
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from concord.nodes.rules.local_filter import SensorGroup
from concord.results.figures.posterior_bound import Truths, posterior_bound
from concord.scenarios.baselines import centralised
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import generator


def truths_of(name: str, runs: int, **fields) -> tuple[Truths, SimpleNamespace]:
    """Truths without any filter, and what the bound needs of the scenario."""
    scenario = scenario_of(name, **fields)
    definition = definition_named(name)
    plant = definition.plant(scenario)
    truth, readings, priors = [], [], []
    cov = np.empty(0)
    for run in range(runs):
        own = scenario.with_(run=run)
        draws = plant.draw(partial(generator, own), scenario.steps)
        state, mean, cov = plant.initial(draws.initial)
        states, seen = [], []
        for step in range(scenario.steps):
            if step:
                state = plant.advance(state, None, draws.process[step - 1], step - 1)
            states.append(state)
            seen.append(plant.observe(state, draws.measurement[step], step))
        truth.append(states)
        readings.append(seen)
        priors.append(mean)
    sensors = [definition.sensor(scenario, node) for node in range(scenario.nodes)]
    parts = SimpleNamespace(
        scenario=scenario,
        model=definition.model(scenario),
        sensors=sensors,
        groups=definition.sensor_groups(scenario),
        prior_cov=cov,
        priors=priors,
    )
    return Truths(np.array(truth), np.array(readings), None), parts


def kalman_cov(parts: SimpleNamespace, steps: int) -> np.ndarray:
    """The covariance of the Kalman filter with all sensors, by the textbook."""
    model, n = parts.model, len(parts.prior_cov)
    F = np.column_stack(
        [model.transition(column, None, 0) - model.transition(np.zeros(n), None, 0)
         for column in np.eye(n)]
    )  # fmt: skip
    rows = []
    for sensor in parts.sensors:
        H = sensor.measure(np.eye(n), 0).T
        _, R = sensor.interpret(np.zeros(len(H)))
        rows += [(h, r) for h, r in zip(H, np.diag(R), strict=True) if np.abs(h).any()]
    H = np.array([h for h, _ in rows])
    R = np.diag([r for _, r in rows])
    P, covs = parts.prior_cov, []
    for step in range(steps):
        if step:
            P = F @ P @ F.T + model.process_noise_cov(0)
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        P = (np.eye(n) - gain @ H) @ P
        covs.append(P)
    return np.array(covs)


def test_on_a_linear_plant_it_is_the_covariance_of_the_kalman_filter():
    truths, parts = truths_of("oscillator", 2, nodes=5, steps=30)
    bound = posterior_bound(truths, parts.prior_cov, parts.model, parts.groups)
    read = ~np.isnan(truths.readings[0, 0]).all(axis=(-1, -2))
    sensors = [sensor for sensor, reads in zip(parts.sensors, read, strict=True) if reads]
    assert 1 < len(sensors) < len(parts.sensors), "a network without a blind node shows less"
    seeing = SimpleNamespace(**{**vars(parts), "sensors": sensors})
    np.testing.assert_allclose(bound, kalman_cov(seeing, 30), rtol=1e-8, atol=0)


@pytest.mark.parametrize("name", ["dc-motor-position", "dc-motor-speed"])
def test_so_it_is_where_some_direction_has_no_noise(name: str):
    truths, parts = truths_of(name, 2, nodes=4, steps=40, control="open")
    bound = posterior_bound(truths, parts.prior_cov, parts.model, parts.groups)
    setup = prepare(parts.scenario)
    filtered = centralised(setup, truths.readings[0], None)
    scale = np.sqrt(np.einsum("kii->ki", filtered.cov))
    relative = (bound - filtered.cov) / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(relative).max() < 1e-6


class Bent:
    """x' = x + 0.1 sin x + noise: a model whose Jacobian is another at every truth."""

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        return state + 0.1 * np.sin(state)

    def process_noise_cov(self, step: int) -> np.ndarray:
        return np.array([[0.04]])


class Squared:
    """y = x^2 / 4 + noise."""

    gate = None

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        return state**2 / 4

    def residual(self, value: np.ndarray, predicted: np.ndarray, /) -> np.ndarray:
        return value - predicted

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return delivered, np.array([[0.09]])


def test_on_a_bent_model_it_is_the_last_block_of_the_joint_information():
    """The recursion is a Schur complement of the information of all states at once."""
    runs, steps = 6, 8
    truth = np.random.default_rng(0).normal(1, 0.7, (runs, steps, 1))
    readings = np.ones((runs, steps, 1, 1, 1))
    readings[2:, 3] = np.nan
    groups = (SensorGroup(slice(None), Squared()),)
    bound = posterior_bound(Truths(truth, readings, None), np.array([[0.25]]), Bent(), groups)
    joint = np.zeros((steps, steps))
    joint[0, 0] = 1 / 0.25
    for step in range(steps):
        slope = truth[:, step, 0] / 2
        missing = np.isnan(readings[:, step, 0, 0, 0])
        joint[step, step] += np.where(missing, 0, slope**2 / 0.09).mean()
        if step + 1 < steps:
            bend = 1 + 0.1 * np.cos(truth[:, step, 0])
            joint[step, step] += (bend**2).mean() / 0.04
            joint[step, step + 1] = joint[step + 1, step] = -bend.mean() / 0.04
            joint[step + 1, step + 1] += 1 / 0.04
    for step in range(steps):
        known = joint[: step + 1, : step + 1].copy()
        if step + 1 < steps:
            # Without what the future says of the last state.
            known[step, step] -= ((1 + 0.1 * np.cos(truth[:, step, 0])) ** 2).mean() / 0.04
        np.testing.assert_allclose(bound[step, 0, 0], np.linalg.inv(known)[-1, -1], rtol=1e-6)


def test_no_filter_of_a_tracking_network_beats_it():
    truths, parts = truths_of("target-tracking", 30, nodes=10, steps=40)
    bound = posterior_bound(truths, parts.prior_cov, parts.model, parts.groups)
    setup = prepare(parts.scenario)
    errors = np.array([
        centralised(
            msgspec.structs.replace(setup, prior_mean=prior.tolist()), readings, None
        ).mean - truth
        for prior, readings, truth in zip(
            parts.priors, truths.readings, truths.truth, strict=True
        )
    ])  # fmt: skip
    measured = np.sqrt((errors[:, 10:, [0, 2]] ** 2).sum(-1).mean())
    least = np.sqrt(np.trace(bound[10:, [0, 2]][:, :, [0, 2]], axis1=1, axis2=2).mean())
    # 30 runs of 30 steps: the measured error is known to about a tenth.
    assert 0.9 * least < measured < 2 * least


def test_it_says_nothing_where_nobody_knows_the_truth():
    truths, parts = truths_of("oscillator", 1, nodes=3, steps=3)
    unknown = truths._replace(truth=np.full_like(truths.truth, np.nan))
    bound = posterior_bound(unknown, parts.prior_cov, parts.model, parts.groups)
    assert np.isnan(bound).all()


def test_of_a_reading_in_part_only_that_part_informs():
    """One step, and the sum over the entries that were taken, one by one."""
    truths, parts = truths_of("target-tracking", 3, nodes=4, steps=1)
    readings = truths.readings.copy()
    readings[0, 0, 1, 0, 0] = readings[1, 0, :, 0, 1] = readings[2, 0, 2] = np.nan
    information = np.linalg.inv(parts.prior_cov)
    for truth, taken in zip(truths.truth[:, 0], readings[:, 0, :, 0], strict=True):
        for sensor, reading in zip(parts.sensors, taken, strict=True):
            dx, dy = truth[[0, 2]] - sensor.position_m
            square = dx * dx + dy * dy
            rows = np.array([[dx, 0, dy, 0, 0], [-dy, 0, dx, 0, 0]])
            rows /= np.array([[np.sqrt(square)], [square]])
            for row, deviation, value in zip(rows, sensor.noise_std, reading, strict=True):
                if not np.isnan(value):
                    information = information + np.outer(row, row) / deviation**2 / 3
    partly = truths._replace(readings=readings)
    [bound] = posterior_bound(partly, parts.prior_cov, parts.model, parts.groups)
    np.testing.assert_allclose(bound, np.linalg.inv(information), rtol=1e-6, atol=1e-6)
