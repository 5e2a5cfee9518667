"""The truth of a linear plant as matrices, read off its own functions."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.local_filter import Model, Sensor, SensorGroup
from concord.scenarios.scenario_definition import ScenarioPlant

_TOLERANCE = 1e-9


class NotExact(ValueError):
    """A scenario that has no exact covariances; the message says why."""


class LinearTruth(NamedTuple):
    """x[k+1] = F x[k] + E w[k] + d[k] and y[k] = H x[k] + o + D v[k] + b, with standard normals.

    Shapes: F (n, n), E (n, q), H (Y, n), D (Y, V), bias b (Y,), with the N r d entries of all
    readings as Y. delivered: (N, r, d), readings of the state zero, NaN where a node is blind.
    state, mean: a constant (n,) and a gain (n, n) on the same normals, of truth and prior mean.
    """

    F: np.ndarray
    E: np.ndarray
    H: np.ndarray
    D: np.ndarray
    bias: np.ndarray
    delivered: np.ndarray
    state: tuple[np.ndarray, np.ndarray]
    mean: tuple[np.ndarray, np.ndarray]
    prior_cov: np.ndarray


def linear_truth(plant: ScenarioPlant, shape: tuple[int, ...], noises: int, n: int) -> LinearTruth:
    """Return the matrices of a plant whose readings are of a shape (N, r, d).

    Raises:
        NotExact: the plant or its sensors are not linear, or change with the step.
    """
    points = np.concatenate([np.zeros((1, n)), np.eye(n), _probe(n)])
    none, still = np.zeros((len(points), noises)), np.zeros((len(points), *shape))
    moved = [plant.advance(points, None, none, step) for step in (1, 8)]
    read = [plant.observe(points, still, step).reshape(len(points), -1) for step in (1, 8)]
    F, H = (
        np.stack([_slopes(each, points, what) for each in both])
        for both, what in ((moved, "its plant"), (read, "a sensor"))
    )
    for both, what in ((F, "its plant"), (H, "a sensor")):
        if not np.allclose(*both, rtol=1e-9, atol=1e-12, equal_nan=True):
            raise NotExact(f"{what} changes with the step")
    zero = np.zeros((noises + 1, n))
    pushed = plant.advance(zero, None, np.eye(noises + 1, noises, k=-1), 1)
    size = int(np.prod(shape))
    noise = np.eye(size + 1, size, k=-1).reshape(size + 1, *shape)
    shaken = plant.observe(np.zeros((size + 1, n)), noise, 1).reshape(size + 1, -1)
    normals = np.eye(n + 1, n, k=-1)
    state, mean, prior_cov = plant.initial(normals)
    return LinearTruth(
        F[0],
        (pushed[1:] - pushed[:1]).T,
        np.nan_to_num(H[0]),
        np.nan_to_num(shaken[1:] - shaken[:1]).T,
        np.zeros(size),
        read[0][0].reshape(shape),
        (state[0], (state[1:] - state[:1]).T),
        (mean[0], (mean[1:] - mean[:1]).T),
        prior_cov,
    )


def believed_transition(model: Model, n: int) -> np.ndarray:
    """Return the F (n, n) of a filter's model."""
    points = np.concatenate([np.zeros((1, n)), np.eye(n), _probe(n)])
    return _slopes(model.transition(points, None, 1), points, "the model")


def weighed_rows(linear: LinearTruth, groups: Sequence[SensorGroup]) -> np.ndarray:
    """Return H' R^-1 (n, Y) of all readings, as the sensors of the nodes believe; 0 for blind."""
    nodes, readings, channels = shape = linear.delivered.shape
    noise_cov = AllSensors(tuple(groups), nodes, (readings, channels)).interpret(linear.delivered)[
        1
    ]
    m, n = noise_cov.shape[-1], len(linear.F)
    sees = ~np.isnan(linear.delivered)[..., :m]
    noise_cov = np.where(sees[..., None] & sees[..., None, :], noise_cov, np.eye(m))
    rows = linear.H.reshape(*shape, n)[:, :, :m]
    weighed = np.zeros((*shape, n))
    weighed[:, :, :m] = np.linalg.inv(noise_cov) @ rows
    return weighed.reshape(-1, n).T


def with_bias(linear: LinearTruth, sensors: Sequence[Sensor | None]) -> LinearTruth:
    """Return the matrices with what the readings of the state zero have beyond the sensors that the
    nodes believe in, as a bias."""
    bias, n = np.zeros_like(linear.delivered), len(linear.F)
    for node, sensor in enumerate(sensors):
        if sensor is not None:
            believed = sensor.measure(np.zeros(n), 1)
            own = linear.delivered[node, :, : len(believed)]
            bias[node, :, : len(believed)] = np.nan_to_num(own - believed)
    return linear._replace(bias=bias.reshape(-1), delivered=linear.delivered - bias)


def _probe(n: int) -> np.ndarray:
    """One state (1, n) that is no multiple of an axis."""
    return np.cos(np.arange(1.0, n + 1))[None] * 3.0


def _slopes(values: np.ndarray, points: np.ndarray, what: str) -> np.ndarray:
    """Slopes (m, n) of values (1 + n + 1, m) at zero, the axes and one more point."""
    slopes = (values[1:-1] - values[:1]).T
    expected = values[0] + slopes @ points[-1]
    scale = np.abs(slopes) @ np.abs(points[-1]) + np.abs(values[0])
    if np.any(np.abs(values[-1] - expected) > _TOLERANCE * scale):
        raise NotExact(f"{what} is not linear")
    return slopes
