"""Sensors and noise of the control plants, which the paper does not specify.

Two presets. `matched` is this project's proposal: several nodes with one scalar sensor each and two
nodes without a sensor; the filter assumes the true noise. `paper` is the paper's own table, for
comparison only (see PAPER_WARNING).
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.features.control.continuous import ContinuousPlant
from concord.plants.linear import Drift, LinearModel, LinearPlant, LinearSensor

Preset = Literal["matched", "paper"]

PAPER_PRIOR_VARIANCE = 50.0

PAPER_WARNING = (
    "noise='paper' takes Q, R and P0 = 50 I as the paper prints them. They describe no physical "
    "noise: Q = p H'H and R = 1 (pitch and motors) are the weights of its LQR, so a filter that "
    "believes them corrects the measured state with gain .981 and the hidden states not at all; "
    "Q = 10 I and R = .05 (bus) stand for 3 m per step and 22 cm. The truth carries no process "
    "noise, as in the paper. Use noise='matched' for any conclusion."
)


class NoisePreset(NamedTuple):
    """Everything random about a plant. Shapes as the fields of LinearPlant; model_cov is Q."""

    model_cov: np.ndarray
    noise_factor: np.ndarray
    sensors: LinearSensor
    prior_cov: np.ndarray
    warning: str


def deal_order(nodes: int) -> NDArray[np.intp]:
    """Which output index each node gets, (nodes,); -1 for a blind one.

    Every fourth node (3, 7, ...) is blind. Of the s nodes that see, each one numbered below s
    keeps its own number as index; the indices that fall on blind nodes go, in order, to the
    remaining seeing nodes. Eight nodes: 0 1 2 - 4 5 3 -, the network of the reproduction.
    Raises ValueError for less than one node.
    """
    if nodes < 1:
        raise ValueError(f"a network of {nodes} nodes: at least 1 is needed")
    number = np.arange(nodes)
    seeing = number % 4 != 3
    keeps = seeing & (number < seeing.sum())
    order = np.full(nodes, -1)
    order[keeps] = number[keeps]
    order[seeing & ~keeps] = np.setdiff1d(np.arange(seeing.sum()), number[keeps])
    return order


def deal_outputs(nodes: int, outputs: np.ndarray, noise_std: np.ndarray) -> LinearSensor:
    """Deal k outputs (k, n) with noise_std (k,) round robin, one to each node that sees.

    Output index i reads outputs[i mod k] with its variance times 1 + floor(i / k): every further
    sensor of the same quantity is a poorer one.
    """
    order = deal_order(nodes)
    kind = order % len(outputs)
    spread = noise_std[kind] * np.sqrt(1 + order // len(outputs))
    blind = order < 0
    rows = np.where(blind[:, None], 0.0, outputs[kind])
    return LinearSensor(rows[:, None, :], np.where(blind, np.nan, spread)[:, None])


def matched_noise(
    nodes: int,
    factor: np.ndarray,
    outputs: np.ndarray,
    noise_std: np.ndarray,
    prior_std: np.ndarray,
) -> NoisePreset:
    """Return the true noise for the filter: Q = E E' for the noise factor E (n, q) of one step.

    outputs: (k, n) rows that nodes can measure; noise_std: (k,); prior_std: (n,).
    """
    sensors = deal_outputs(nodes, outputs, noise_std)
    return NoisePreset(factor @ factor.T, factor, sensors, np.diag(prior_std**2), "")


def paper_noise(
    nodes: int, model_cov: np.ndarray, output_row: np.ndarray, variance: float
) -> NoisePreset:
    """The paper's Q and R: a seeing node measures the controlled output (1, n), nothing else.

    The truth has no process noise: the paper compares with "the true values, having no noise".
    """
    n = len(model_cov)
    blind = deal_order(nodes) < 0
    rows = np.where(blind[:, None, None], 0.0, output_row)
    noise_std = np.where(blind, np.nan, np.sqrt(variance))[:, None]
    sensors = LinearSensor(rows, noise_std)
    prior_cov = PAPER_PRIOR_VARIANCE * np.eye(n)
    return NoisePreset(model_cov, np.zeros((n, 0)), sensors, prior_cov, PAPER_WARNING)


def choose(noise: Preset, matched: NoisePreset, paper: NoisePreset) -> NoisePreset:
    """Return the preset of that name. Raises ValueError for another name."""
    presets = {"matched": matched, "paper": paper}
    if noise not in presets:
        raise ValueError(
            f"noise {noise!r} is not a preset; choose 'matched' (physical, consistent) "
            "or 'paper' (as printed, for comparison)"
        )
    return presets[noise]


def linear_plant(
    continuous: ContinuousPlant,
    time_step_s: float,
    preset: NoisePreset,
    *,
    known_drift: Drift | None = None,
    unknown_drift: Drift | None = None,
) -> LinearPlant:
    """Return the sampled plant with that noise, at rest in the origin."""
    transition_matrix, control_matrix = continuous.sampled(time_step_s)
    return LinearPlant(
        name=continuous.name,
        time_step_s=time_step_s,
        state_names=continuous.state_names,
        state_units=continuous.state_units,
        model=LinearModel(transition_matrix, control_matrix, preset.model_cov, known_drift),
        noise_factor=preset.noise_factor,
        sensors=preset.sensors,
        initial_state=np.zeros(len(transition_matrix)),
        prior_cov=preset.prior_cov,
        unknown_drift=unknown_drift,
        warning=preset.warning,
    )
