"""The model of Meng et al. (2025), written differently, and one run of it behind its bus."""

from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.stochastic_ukf import Dynamics, Observation, Received
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented

N, M = 2, 6
PAPER_POINTS = scaled_unscented(N, 1.0, 2.0, 0.0)


class Moment(NamedTuple):
    pi: np.ndarray
    gamma: np.ndarray


def paper_f(step: int, x: np.ndarray) -> np.ndarray:
    a, b = x[..., 0], x[..., 1]
    moved = [
        0.58 * a + 0.3 * np.cos(step) * a + 0.39 * b,
        0.28 * a + 0.2 * np.sin(step) * a + 0.52 * b,
    ]
    return np.stack(moved, axis=-1)


def paper_h(step: int, x: np.ndarray) -> np.ndarray:
    a, b = x[..., 0], x[..., 1]
    cosine, sine = np.cos(step), np.sin(step)
    seen = [
        0.36 * a + b * b, a * b + 0.16 * b, 0.8 * cosine * a + 0.36 * b,
        0.5 * a + a * b, 0.7 * cosine * a + 0.8 * b, 0.3 * a + 0.8 * sine * b,
    ]  # fmt: skip
    return np.stack(seen, axis=-1)


GAMMA = np.diag([0.04, 0.09])
PI_1 = np.array([[0.09, 0.06], [0.06, 0.04]])
U_1 = np.array([0.3, 0.2, 0.1, 0.1, 0.2, 0.3])
PROCESS = Moment(PI_1[None], GAMMA[None])
SENSING = Moment(np.outer(U_1, U_1)[None], GAMMA[None])


def paper_dynamics(step: int) -> Dynamics:
    return Dynamics(partial(paper_f, step), 0.05 * np.eye(N), PROCESS)


def paper_observation(step: int) -> Observation:
    return Observation(partial(paper_h, step), 0.01 * np.eye(M), SENSING)


def paper_run(seed: int, steps: int) -> tuple[Gaussian, np.ndarray, np.ndarray]:
    """Prior, ybar_s and what is fresh in slots 1..steps: 1 2 3 4, then 5 or 6 by chance."""
    generator = np.random.default_rng(seed)
    prior = Gaussian(np.array([5.0, -2.0]), np.eye(N))
    x = generator.multivariate_normal(*prior)
    held = paper_h(0, prior.mean)
    received, fresh = [], []
    for step in range(1, steps + 1):
        eta = generator.standard_normal(N) @ np.sqrt(GAMMA)
        x = paper_f(step - 1, x) + np.array([0.3, 0.2]) * (eta @ x)
        x = x + np.sqrt(0.05) * generator.standard_normal(N)
        zeta = generator.standard_normal(N) @ np.sqrt(GAMMA)
        y = paper_h(step, x) + U_1 * (zeta @ x) + 0.1 * generator.standard_normal(M)
        sender = (step - 1) % 5 if step % 5 else generator.integers(4, 6)
        mask = np.arange(M) == sender
        held = np.where(mask, y, held)
        received.append(held)
        fresh.append(mask)
    return prior, np.array(received), np.array(fresh)


def follow(method, prior: Gaussian, received, fresh, rule: SigmaPointRule = PAPER_POINTS) -> list:
    """The states at steps 0, 1, 2, ..."""
    states = [method.start(prior, paper_observation(0), rule)]
    for step, slot in enumerate(zip(received, fresh, strict=True), start=1):
        moved = method.predict(states[-1], paper_dynamics(step - 1), rule)
        states.append(method.update(moved, Received(*slot), paper_observation(step), rule))
    return states
