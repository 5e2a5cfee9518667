"""What Figs. 10-14 of the consensus paper show: the plants in their loops, seen by a network.

The paper names neither network nor noise. Here eight nodes on a ring run its rule, the weighted
average, with three rounds per step and matched noise. The loop is closed through the true state, as
in the paper's design; the estimate shown is that of a node that measures nothing.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.closed_loop import Controller, closed_loop
from concord.features.control.continuous import ContinuousPlant
from concord.features.control.controllers import StateFeedback
from concord.features.control.design import placed_feedback
from concord.features.control.references import Staircase, constant
from concord.filters.fusion import hold
from concord.filters.fusion.averaging import MOMENTS
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.lanes.beliefs import BatchedBeliefs
from concord.nodes.lanes.links import Shares, links_of
from concord.nodes.rules.belief_consensus import HoldPolicy
from concord.nodes.rules.local_filter import (
    LocalFilters,
    SensorGroup,
    predict_to_step,
    update_with_readings,
)
from concord.nodes.vector_codec import BeliefCodec
from concord.plants.linear import LinearPlant, LinearSensor, Signal
from concord.plants.placement import Draws, standard_draws
from concord.studies.progress import progress
from concord.topology.adjacency import neighbours_of
from concord.topology.graphs import ring
from concord.topology.weights import metropolis, per_node

NODES = 8
ROUNDS = 3
MEASURING_NODE = 0  # it measures the controlled output, on every plant
BLIND_NODE = 3

# Which state is the controlled output.
OUTPUT = {"cruise": 0, "bus": 2, "pitch": 2, "speed": 0, "position": 0}

# The paper shows two references for each motor, without numbers.
STAIRS = Staircase(((0.5,), (1.5,), (1.0,)), (100, 100, 100))


class Trial(NamedTuple):
    """One control loop over T times.

    times_s (T,); reference (T,), or None if the loop follows no reference. truth, estimated and
    central (T, n): of the plant, of the blind node, of a filter that has all readings. measured
    (T,) by the measuring node. integral (T,) of the controlled output, in its unit times s.
    """

    times_s: np.ndarray
    reference: np.ndarray | None
    truth: np.ndarray
    measured: np.ndarray
    estimated: np.ndarray
    central: np.ndarray
    integral: np.ndarray


class Loop(NamedTuple):
    """A controller, and whether what it follows is a reference for the output."""

    controller: Controller
    follows: bool


def measure(seed: int) -> dict[str, dict[str, Trial]]:
    """All trials, by plant and by loop."""
    trials = {}
    plants = _plants()
    with progress("responses", len(plants)) as done:
        for count, (name, (plant, loops, seconds)) in enumerate(plants.items(), start=1):
            steps = round(seconds / plant.time_step_s)
            trials[name] = _trials(plant, loops, OUTPUT[name], steps, seed)
            done(count)
    return trials


def rmse(trial: Trial, values: np.ndarray, output: int, skip: float = 0.5) -> float:
    """Root mean square error of values (T,) of the output, without the first part of the trial."""
    first = round(skip * len(values))
    return float(np.sqrt(np.mean((values - trial.truth[:, output])[first:] ** 2)))


def _drive(gain: float, signal: Signal, states: int) -> StateFeedback:
    """No feedback: the control is gain times the signal."""
    return StateFeedback(np.zeros((1, states)), np.array([[gain]]), signal)


def _plants() -> dict[str, tuple[LinearPlant, dict[str, Loop], float]]:
    """Plants by name with their loops, and the seconds that a figure shows."""
    designed = pitch.pitch_controller()
    pitched = {
        f"closed loop, to {level} rad": Loop(
            StateFeedback(designed.gain, designed.precompensation, constant(level)), follows=True
        )
        for level in (0.2, 0.5)
    }
    held = Loop(_drive(1.0, constant(0.2), 3), follows=False)
    # The nominal 500 N of the paper are what 10 m/s need at rest.
    nominal = _drive(cruise.DAMPING_N_S_PER_M, cruise.REFERENCE, 1)
    volts = _drive(1 / float(motor.speed_transfer_function()(0)), STAIRS, 2)
    cruised = {
        "closed loop": Loop(cruise.cruise_controller(), follows=True),
        "open loop: 500 N, then 350 N": Loop(nominal, follows=True),
    }
    sprung = {
        "open loop": Loop(_drive(0.0, constant(0.0), 4), follows=False),
        "closed loop": Loop(suspension.suspension_controller(), follows=True),
    }
    turned = _motor_loops(motor.speed_dynamics(), motor.SPEED_POLES)
    placed = _motor_loops(motor.position_dynamics(), motor.POSITION_POLES)
    five_volt = Loop(_drive(1.0, constant(5.0), 3), follows=False)
    return {
        "cruise": (cruise.cruise(), cruised, 50.0),
        "bus": (suspension.suspension(road=suspension.ROAD_STEP), sprung, 5.0),
        "pitch": (pitch.pitch(), {**pitched, "open loop: elevator at 0.2 rad": held}, 7.0),
        "speed": (
            motor.motor_speed(),
            {**turned, "open loop: 10.01 V per rad/s": Loop(volts, follows=True)},
            3.0,
        ),
        "position": (motor.motor_position(), {**placed, "open loop: 5 V": five_volt}, 3.0),
    }


def _motor_loops(plant: ContinuousPlant, poles: Sequence[complex]) -> dict[str, Loop]:
    references = {"closed loop, square": motor.REFERENCE, "closed loop, stairs": STAIRS}
    return {
        title: Loop(placed_feedback(plant, motor.TIME_STEP_S, poles, signal), follows=True)
        for title, signal in references.items()
    }


def _trials(
    plant: LinearPlant, loops: dict[str, Loop], output: int, steps: int, seed: int
) -> dict[str, Trial]:
    """All loops of a plant, each with noise of its own, as lanes of one computation."""
    # With one noise for all, the errors of linear loops would be equal, whatever the control.
    draws = [_draws(plant, steps, seed, lane) for lane in range(len(loops))]
    responses = [
        closed_loop(plant, loop.controller, noise)
        for loop, noise in zip(loops.values(), draws, strict=True)
    ]
    _, prior_mean, prior_cov = plant.initial(np.stack([noise.initial for noise in draws]))
    readings = np.stack([response.delivered for response in responses], axis=1)
    controls = np.stack([response.controls for response in responses], axis=1)
    prior = Gaussian(prior_mean, np.broadcast_to(prior_cov, (len(loops), *prior_cov.shape)))
    network = _network_means(plant, prior, readings, controls)[:, :, BLIND_NODE]
    central = _central_means(plant, prior, readings, controls)
    return {
        title: Trial(
            times_s=plant.time_step_s * np.arange(steps, dtype=np.float64),
            reference=response.references[:, 0] if loop.follows else None,
            truth=response.states,
            measured=response.delivered[:, MEASURING_NODE, 0, 0],
            estimated=network[:, lane],
            central=central[:, lane],
            integral=plant.time_step_s * np.cumsum(response.states[:, output]),
        )
        for lane, ((title, loop), response) in enumerate(zip(loops.items(), responses, strict=True))
    }


def _network_means(
    plant: LinearPlant, prior: Gaussian, readings: np.ndarray, controls: np.ndarray
) -> np.ndarray:
    """Means (steps, R, N, n) of the network from readings (steps, R, N, r, d) and controls."""
    neighbours = neighbours_of(ring(NODES))
    weights = per_node(metropolis(ring(NODES)), neighbours)
    own, others = [row[0] for row in weights], [one for row in weights for one in row[1:]]
    rule = BatchedBeliefs(
        filters=LocalFilters(
            plant.model,
            (SensorGroup(slice(None), plant.sensors),),
            SigmaPointFilter(scaled_unscented(len(plant.state_names))),
        ),
        averaging=MOMENTS,
        hold=HoldPolicy(lambda base, ages, *_: hold.renormalise(base, ages), carried=False),
        links=links_of(neighbours, perfect=True),
        base=Shares(np.array([own]), np.array([others])),
        rounds=ROUNDS,
        contenders=np.empty(0, dtype=np.int64),
        codec=BeliefCodec(len(plant.state_names)).vector,
        trigger=0.0,
    )
    everybody = np.ones(readings.shape[1:3], dtype=bool)
    content = rule.start(Gaussian(*(np.repeat(part[:, None], NODES, axis=1) for part in prior)))
    means = []
    for step, delivered in enumerate(readings):
        content = rule.begin_step(content, delivered, controls[step - 1] if step else None, step)
        for _ in range(ROUNDS):
            content = rule.exchange(content, everybody, None)
        means.append(rule.belief(content).mean)
    return np.array(means)


def _central_means(
    plant: LinearPlant, belief: Gaussian, readings: np.ndarray, controls: np.ndarray
) -> np.ndarray:
    """Means (steps, R, n) of a filter that takes the readings of all nodes."""
    ukf = SigmaPointFilter(scaled_unscented(len(plant.state_names)))
    rows = plant.sensors.rows
    every = LinearSensor(rows.reshape(-1, rows.shape[-1]), plant.sensors.noise_std.ravel())
    means = []
    for step, delivered in enumerate(readings):
        if step:
            belief = predict_to_step(belief, controls[step - 1], step, plant.model, ukf).beliefs
        together = delivered.reshape(len(delivered), 1, -1)
        belief = update_with_readings(belief, together, step, every, ukf).belief
        means.append(belief.mean)
    return np.array(means)


def _draws(plant: LinearPlant, steps: int, seed: int, lane: int) -> Draws:
    def stream(purpose: str, node: int) -> np.random.Generator:
        key = (lane, ("initial", "process", "measurement").index(purpose), node)
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))

    n, q = plant.noise_factor.shape
    return standard_draws(stream, n, q, (NODES, 1, 1), steps)
