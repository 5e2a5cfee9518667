"""A plant seen through cycles of a bus: l outputs in turn, then the most changed of the others.

A cycle has g = l + 1 steps. In step r < l the bus sends output r (round robin). In step l it sends
one of the other outputs (try once discard): the one that differs most, by weight, from its last
sent value. The last values of these outputs are held. Outputs, cycles and steps count from 0.

The estimator works once per cycle. `lift` turns g steps of the plant into one, and `augment` adds
the held values to the state. A cycle is then exactly one step of a time-varying linear system.

Source: Liu et al. (2021), equations (3) to (16), read with the phase of a cycle as its step modulo
l + 1 (printed: modulo l) and with arg max in (5).
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

WeightsAtStep = Callable[[int], np.ndarray]
"""step -> Q (m - l,) of the contending outputs in it, positive."""


class LinearBoundedSystem(Protocol):
    """x' = A x + B v, y = C x + D v with |v| <= 1 (see `concord.features.sets.bounded`)."""

    @property
    def transition(self) -> Callable[[int], np.ndarray]: ...

    @property
    def output(self) -> Callable[[int], np.ndarray]: ...

    def scaled_noise_input(self, step: int) -> np.ndarray: ...

    def scaled_feedthrough(self, step: int) -> np.ndarray: ...

    def majorant(self) -> "LinearBoundedSystem": ...


class DeliveredValues(NamedTuple):
    """Values that the bus delivers.

    Attributes:
        values: (..., cycles, m), ybar(t_k): the outputs sent in cycle k, held ones where not sent.
        held: (..., cycles, m - l), of the contending outputs before each cycle.
        winner: (..., cycles), which of the contending outputs was sent, 0..m-l-1; -1 where none
            was received.
        limit: (..., cycles), no loser's weighted squared change was larger than this.
    """

    values: np.ndarray
    held: np.ndarray
    winner: NDArray[np.int_]
    limit: np.ndarray


class LiftedCycle(NamedTuple):
    """One cycle as one step; noise (rows, g, q) acts on the g samples v, each |v| <= 1.

    states (g n, n): x in steps 1..g of the cycle, one after the other, from x at its beginning.
    outputs (m, n): each output in the step in which it would be sent. weights (m - l,): of (5).
    majorant: the same of `BoundedSystem.majorant`, which itself has none.
    """

    states: np.ndarray
    states_noise: np.ndarray
    outputs: np.ndarray
    outputs_noise: np.ndarray
    weights: np.ndarray
    majorant: "LiftedCycle | None" = None


class AugmentedCycle(NamedTuple):
    """(16): z = (x in the g steps before the cycle, held), N = g n + m - l, and v as above.

        z+ = transition z + noise v,   ybar = output z + output_noise v

    candidates (m - l, N) and candidates_noise: change of each contending output since it was sent.
    `winner` (...) of them was sent, -1 for none. Its squared change times `weights` (m - l,) is the
    largest, up to `excess` (...), for a bus tells changes apart only so far.
    majorant: the same of the lifted cycle's, for bounds of rounding.
    """

    transition: np.ndarray
    noise: np.ndarray
    output: np.ndarray
    output_noise: np.ndarray
    candidates: np.ndarray
    candidates_noise: np.ndarray
    weights: np.ndarray
    winner: NDArray[np.int_]
    excess: np.ndarray
    majorant: "AugmentedCycle | None" = None


def lift(
    system: LinearBoundedSystem, static_outputs: int, weights: WeightsAtStep, cycle: int
) -> LiftedCycle:
    """Lemmas 1 and 2: the plant over the l + 1 steps of a cycle.

    Raises:
        ValueError: the weights do not fit the contending outputs, or one is not positive.
    """
    first = cycle * (static_outputs + 1)
    contending = len(system.output(first)) - static_outputs
    of_outputs = np.asarray(weights(first + static_outputs))
    if of_outputs.shape != (contending,) or not (of_outputs > 0.0).all():
        raise ValueError(
            f"weights {of_outputs.tolist()} of {contending} contending outputs; give one positive "
            "number for each, so that the winner's change is the largest"
        )
    of_cycle = _lifted(system, static_outputs, weights, cycle)
    majorant = _lifted(system.majorant(), static_outputs, weights, cycle)
    return of_cycle._replace(majorant=majorant)


def _lifted(
    system: LinearBoundedSystem, static_outputs: int, weights: WeightsAtStep, cycle: int
) -> LiftedCycle:
    length = static_outputs + 1
    first = cycle * length
    noise = system.scaled_noise_input(first)
    n, q = noise.shape
    m = len(system.output(first))
    state, state_noise = np.eye(n), np.zeros((n, length, q))
    states, states_noise, outputs, outputs_noise = [], [], [], []
    for r in range(length):
        step = first + r
        rows = [r] if r < static_outputs else list(range(static_outputs, m))
        output = system.output(step)[rows]
        disturbed = np.tensordot(output, state_noise, 1)
        disturbed[:, r] += system.scaled_feedthrough(step)[rows]
        outputs.append(output @ state)
        outputs_noise.append(disturbed)
        transition = system.transition(step)
        state = transition @ state
        state_noise = np.tensordot(transition, state_noise, 1)
        state_noise[:, r] += system.scaled_noise_input(step)
        states.append(state)
        states_noise.append(state_noise)
    parts = (states, states_noise, outputs, outputs_noise)
    lifted, lifted_noise, seen, seen_noise = (np.concatenate(part) for part in parts)
    return LiftedCycle(lifted, lifted_noise, seen, seen_noise, weights(first + static_outputs))


def augment(cycle: LiftedCycle, winner: NDArray[np.int_], excess: np.ndarray) -> AugmentedCycle:
    """(12) and (16) of a cycle in which `winner` (...) of the contending outputs was sent.

    `excess` (...): by how much a loser's weighted squared change may be larger than the winner's.
    """
    span, n = cycle.states.shape
    m, contending = len(cycle.outputs), len(cycle.weights)
    static, size = m - contending, span + contending
    last, held = np.arange(span - n, span), np.arange(span, size)
    sent = (np.arange(contending) == np.asarray(winner)[..., None]).astype(float)
    lanes = sent.shape[:-1]
    output = np.zeros((*lanes, m, size))
    output[..., :static, last] = cycle.outputs[:static]
    output[..., static:, last] = sent[..., None] * cycle.outputs[static:]
    output[..., static + np.arange(contending), held] = 1.0 - sent
    output_noise = np.broadcast_to(cycle.outputs_noise, (*lanes, *cycle.outputs_noise.shape)).copy()
    output_noise[..., static:, :, :] *= sent[..., None, None]
    transition = np.zeros((*lanes, size, size))
    transition[..., :span, last] = cycle.states
    transition[..., span:, :] = output[..., static:, :]
    noise = np.zeros((*lanes, size, *cycle.states_noise.shape[1:]))
    noise[..., :span, :, :] = cycle.states_noise
    noise[..., span:, :, :] = output_noise[..., static:, :, :]
    candidates = np.zeros((contending, size))
    candidates[:, last] = cycle.outputs[static:]
    candidates[:, held] = -np.eye(contending)
    return AugmentedCycle(
        transition, noise, output, output_noise,
        candidates, cycle.outputs_noise[static:], cycle.weights, np.asarray(winner), excess,
        None if cycle.majorant is None else augment(cycle.majorant, winner, excess),
    )  # fmt: skip
