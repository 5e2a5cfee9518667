"""`liu2021`: four sensors and one estimator of sets on a FlexRay measurement bus.

Step k is the paper's instant kh: sensors 1 and 2 send in the steps 0 and 1 of a cycle of three, and
in the third one of sensors 3 and 4. The plant is as printed and unstable, so its first state is
large after many steps. `concord.features.measurement_bus.measured` has the options.
"""

from functools import cache, partial

import numpy as np

from concord.features.measurement_bus.measured import (
    PlantOnBus,
    measured_definition,
    plant_of_system,
)
from concord.features.measurement_bus.options import Reception, SensorSlots
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded_network import on_the_bound
from concord.features.sets.bounded_on_a_bus import BoundedOnBus, as_gaussian, inside
from concord.features.sets.options import BoundedReceiver, EllipsoidReceiver
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Score
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.plants import SensorNetwork

_ALL_STATES = tuple(range(liu2021.STATES))


def _weights(step: int) -> tuple[np.ndarray, ...]:
    """Weights of all four sensors; those of the first two never matter."""
    every = np.concatenate([np.ones(liu2021.STATIC_OUTPUTS), liu2021.weights(step)])
    return tuple(every[:, None, None])


@cache
def plant_on_bus(noise: str) -> PlantOnBus:
    """The example, with its noise on the bound ("matched") or as printed ("paper")."""
    printed = noise == "paper"
    drawn = partial(on_the_bound, size=1)
    plant = BoundedOnBus(
        liu2021.SYSTEM,
        np.zeros(liu2021.STATES),
        np.eye(liu2021.STATES),
        (lambda _, steps: liu2021.printed_noise(steps)) if printed else drawn,
        (lambda _: liu2021.INITIAL_STATE) if printed else inside,
        ("x1", "x2", "x3", "x4"),
        ("1",) * liu2021.STATES,
    )
    system = as_gaussian(liu2021.SYSTEM, liu2021.STATES)
    return plant_of_system(plant, system)._replace(
        weights=_weights, bounded=liu2021.SYSTEM, held_half_width=1.0
    )


def _plant_of(scenario: Scenario) -> PlantOnBus:
    assert isinstance(scenario.plant, BoundedReceiver), "the catalogue chose this file"
    return plant_on_bus(scenario.plant.noise)


DEFINITION = measured_definition(
    Scenario(
        plant=BoundedReceiver(),
        network=SensorNetwork(nodes=1 + liu2021.OUTPUTS, graph="star"),
        rule=Reception(),
        rounds=1,
        bus=FlexRay(schedule=SensorSlots(static_slots=liu2021.STATIC_OUTPUTS)),
        filter=EllipsoidReceiver(),
        steps=liu2021.STEPS,
    ),
    _plant_of,
    Score(states=_ALL_STATES, unit="1", nees_states=_ALL_STATES, first_step=1),
)
