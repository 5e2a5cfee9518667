"""`oscillator`: a linear plant, on which every filter can be checked against the Kalman filter.

Reason for a file of its own: an entry names it.
"""

from functools import cache

from concord.plants.oscillator import Oscillation, Oscillator
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.plants import DampedOscillator, SensorNetwork

DEFAULTS = Scenario(
    plant=DampedOscillator(), network=SensorNetwork(nodes=8, graph="ring"), steps=200
)


@cache
def _plant(nodes: int) -> Oscillator:
    return Oscillator(nodes)


DEFINITION = ScenarioDefinition(
    defaults=DEFAULTS,
    # Any number of nodes will do.
    check=lambda _: None,
    plant=lambda scenario: _plant(scenario.nodes),
    model=lambda _: Oscillation(),
    sensor=lambda scenario, node: _plant(scenario.nodes).sensor(node),
    sensors=lambda scenario: _plant(scenario.nodes).sensors,
    score=Score(states=(0,), unit="m", nees_states=(0, 1), first_step=20),
)
