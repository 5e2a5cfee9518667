"""`meng2025`: six sensors and one estimator on a FlexRay measurement bus, one slot per step.

Step s is the paper's s: step 0 is the prior, slot 1 belongs to step 1, and node j is the paper's
sensor j. `concord.features.measurement_bus.measured` has the options.
"""

from functools import cache

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.measured import (
    PlantOnBus,
    measured_definition,
    plant_of_system,
)
from concord.features.measurement_bus.options import (
    Reception,
    RecommendedFilter,
    SensorSlots,
    StochasticReceiver,
)
from concord.features.measurement_bus.sensed import sensors_on_a_bus
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Score
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.plants import SensorNetwork

SYSTEM, SENSORS = meng2025.SYSTEM, meng2025.SENSORS


def paper_points(alpha: float = 1.0) -> SigmaPointRule:
    """The points of the paper: gamma = n (alpha^2 - 1), beta = 2."""
    return scaled_unscented(meng2025.STATES, alpha, beta=2.0, kappa=0.0)


@cache
def plant_on_bus() -> PlantOnBus:
    """The example, its sensors and its points."""
    truth = meng2025.plant(sensors_on_a_bus(SENSORS))
    return plant_of_system(truth, SYSTEM)._replace(points=paper_points(), first_slot=1)


DEFINITION = measured_definition(
    Scenario(
        plant=StochasticReceiver(),
        network=SensorNetwork(nodes=1 + SENSORS, graph="star"),
        rule=Reception(),
        rounds=1,
        bus=FlexRay(schedule=SensorSlots(static_slots=meng2025.STATIC_SLOTS)),
        filter=RecommendedFilter(),
        steps=101,
    ),
    lambda _: plant_on_bus(),
    Score(states=(0, 1), unit="1", nees_states=(0, 1), first_step=1),
)
