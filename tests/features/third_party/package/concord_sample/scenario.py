"""A scenario of a plant that concord has."""

from concord.scenarios.definitions import oscillator
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition
from concord.scenarios.types.plants import SensorNetwork

from .options import ShortOscillator

_NETWORK = SensorNetwork(nodes=4, graph="ring")
DEFINITION = ScenarioDefinition(
    defaults=Scenario(plant=ShortOscillator(), network=_NETWORK, steps=30),
    check=oscillator.DEFINITION.check,
    plant=oscillator.DEFINITION.plant,
    model=oscillator.DEFINITION.model,
    sensor=oscillator.DEFINITION.sensor,
    sensors=oscillator.DEFINITION.sensors,
    score=oscillator.DEFINITION.score,
)
