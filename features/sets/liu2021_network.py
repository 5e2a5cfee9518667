"""`liu2021-network`: the set-membership example with its four outputs dealt out to the nodes.

`--rule ellipsoid` and `--rule zonotope` keep sets that hold the truth for certain; the Gaussian
rules run on it too, and do not. The plant is unstable: by default the estimate of node 0 controls
it, as nothing in the paper does; `--control open` is the plant as printed, whose first state grows
by a sixth in every step. `--noise matched` draws noise on its bound, `paper` takes the printed one.
"""

from functools import cache

from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded_network import BoundedNetwork
from concord.features.sets.options import EllipsoidIntersection, UnstableBounded
from concord.scenarios.definitions.closed_loop import OPEN, check_control, controlled
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.plants import SensorNetwork

_STEPS = 1000


@cache
def _made(nodes: int, noise: str) -> BoundedNetwork:
    return liu2021.network(nodes, noise)


def _plant(scenario: Scenario) -> BoundedNetwork:
    return _made(scenario.nodes, controlled(scenario).noise)


def _controller(scenario: Scenario) -> liu2021.Stabiliser | None:
    return None if controlled(scenario).control == OPEN else liu2021.Stabiliser()


DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=UnstableBounded(),
        network=SensorNetwork(nodes=6, graph="ring"),
        rule=EllipsoidIntersection(),
        steps=_STEPS,
    ),
    check=check_control,
    plant=_plant,
    model=lambda scenario: _plant(scenario).model,
    sensor=lambda scenario, node: _plant(scenario).sensor(node),
    score=Score(states=(0, 1, 2, 3), unit="1", nees_states=(0, 1, 2, 3), first_step=20),
    controller=_controller,
)
