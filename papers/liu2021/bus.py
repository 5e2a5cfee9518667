"""A bounded plant over a FlexRay measurement bus, as the set-membership filters see each cycle.

Plants and filters know nothing of each other; here the lifted plant and what the bus delivered
become the cycle of `concord.papers.liu2021.cycle` and the evidence of
`concord.papers.liu2021.evidence`. Leading axes of what was received are lanes.
"""

from typing import NamedTuple

import numpy as np

from concord.papers.liu2021.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    bus_evidence,
    no_readings,
)
from concord.papers.liu2021.flexray_cycle import (
    AugmentedCycle,
    DeliveredValues,
    WeightsAtCycle,
    augment,
    lift,
)
from concord.plants.bounded import BoundedSystem


class MeasuredPlant(NamedTuple):
    """A plant, l of whose outputs are sent in turn, and the weights of the others (5)."""

    system: BoundedSystem
    static_outputs: int
    weights: WeightsAtCycle

    @property
    def length(self) -> int:
        """Steps of a cycle, g = l + 1."""
        return self.static_outputs + 1


def augmented(plant: MeasuredPlant, received: DeliveredValues, cycle: int) -> AugmentedCycle:
    """A cycle for the paper's estimator and its fast form."""
    lifted = lift(plant.system, plant.static_outputs, plant.weights, cycle)
    return augment(lifted, received.winner[..., cycle])


def cycle_evidence(plant: MeasuredPlant, received: DeliveredValues, cycle: int) -> StepReadings:
    """A cycle as one step: of x at its beginning, what becomes of x in its g steps (g n,)."""
    lifted = lift(plant.system, plant.static_outputs, plant.weights, cycle)
    values = received.values[..., cycle, :]
    reached = lifted.majorant or lifted
    moved = BoundedMotion(reached.states, reached.states_noise)
    seen = BoundedMotion(reached.outputs, reached.outputs_noise)
    outputs = Readings(lifted.outputs, lifted.outputs_noise, values, np.zeros(values.shape), seen)
    return bus_evidence(
        BoundedMotion(lifted.states, lifted.states_noise, moved),
        outputs,
        plant.static_outputs,
        lifted.weights,
        received.held[..., cycle, :],
        received.winner[..., cycle],
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
            steps.append(bus_evidence(motion, outputs, 0, plant.weights(step), held, winner))
    return steps
