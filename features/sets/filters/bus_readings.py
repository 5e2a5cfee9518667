"""A bounded plant over a measurement bus, as the set-membership filters see each cycle.

Plants and filters know nothing of each other; here the lifted plant and what the bus delivered
become the cycle of `concord.features.sets.filters.cycle` and the evidence of
`concord.features.sets.filters.evidence`. Leading axes of what was received are lanes.
"""

from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    bus_evidence,
    no_readings,
)
from concord.features.sets.filters.lifted_cycle import (
    AugmentedCycle,
    DeliveredValues,
    LiftedCycle,
    LinearBoundedSystem,
    WeightsAtStep,
    augment,
    lift,
)

System = TypeVar("System", bound=LinearBoundedSystem)


class MeasuredPlant(NamedTuple, Generic[System]):
    """A plant, l of whose outputs are sent in turn, and the weights of the others (5)."""

    system: System
    static_outputs: int
    weights: WeightsAtStep

    @property
    def length(self) -> int:
        """Steps of a cycle, g = l + 1."""
        return self.static_outputs + 1


def augmented(plant: MeasuredPlant, received: DeliveredValues, cycle: int) -> AugmentedCycle:
    """A cycle for the paper's estimator and its fast form."""
    lifted = lift(plant.system, plant.static_outputs, plant.weights, cycle)
    winner = received.winner[..., cycle]
    return augment(lifted, winner, _excess(plant, lifted.weights, received, cycle))


def _excess(
    plant: MeasuredPlant, weights: np.ndarray, received: DeliveredValues, cycle: int
) -> np.ndarray:
    """By how much (...) a loser's weighted squared change may be above the winner's.

    0 where no winner was received.
    """
    if not len(weights):
        return np.zeros(received.winner.shape[:-1])
    change = received.values[..., cycle, plant.static_outputs :] - received.held[..., cycle, :]
    winner = received.winner[..., cycle, None]
    largest = np.take_along_axis(weights * change**2, winner, -1)[..., 0]
    excess = np.maximum(received.limit[..., cycle] - largest, 0.0)
    return np.where(received.winner[..., cycle] < 0, 0.0, excess)


def cycle_evidence(plant: MeasuredPlant, received: DeliveredValues, cycle: int) -> StepReadings:
    """A cycle as one step: of x at its beginning, what becomes of x in its g steps (g n,)."""
    lifted = lift(plant.system, plant.static_outputs, plant.weights, cycle)
    return lifted_evidence(
        lifted,
        received.values[..., cycle, :],
        received.held[..., cycle, :],
        received.winner[..., cycle],
        received.limit[..., cycle],
    )


def lifted_evidence(
    lifted: LiftedCycle,
    values: np.ndarray,
    held: np.ndarray,
    winner: NDArray[np.int_],
    limit: np.ndarray,
) -> StepReadings:
    """The same of a cycle in which `values` (..., m) came; the others as in `DeliveredValues`."""
    reached = lifted.majorant or lifted
    moved = BoundedMotion(reached.states, reached.states_noise)
    seen = BoundedMotion(reached.outputs, reached.outputs_noise)
    outputs = Readings(lifted.outputs, lifted.outputs_noise, values, np.zeros(values.shape), seen)
    return bus_evidence(
        BoundedMotion(lifted.states, lifted.states_noise, moved),
        outputs,
        values.shape[-1] - len(lifted.weights),
        lifted.weights,
        held,
        winner,
        limit,
    )


def step_evidence(
    plant: MeasuredPlant, received: DeliveredValues, cycle: int
) -> list[StepReadings]:
    """The g steps of a cycle one by one, each with what was sent in it."""
    system, static = plant.system, plant.static_outputs
    steps = []
    for r in range(plant.length):
        step = cycle * plant.length + r
        noise = system.scaled_noise_input(step)[:, None, :]
        motion = BoundedMotion(system.transition(step), noise)
        rows = np.array([r]) if r < static else np.arange(static, received.values.shape[-1])
        values = received.values[..., cycle, rows]
        outputs = Readings(
            system.output(step)[rows],
            system.scaled_feedthrough(step)[rows][:, None, :],
            values,
            np.zeros(values.shape),
        )
        if r < static:
            steps.append(StepReadings(motion, outputs, no_readings(outputs)))
        else:
            held, winner = received.held[..., cycle, :], received.winner[..., cycle]
            weights, limit = plant.weights(step), received.limit[..., cycle]
            steps.append(bus_evidence(motion, outputs, 0, weights, held, winner, limit))
    return steps
