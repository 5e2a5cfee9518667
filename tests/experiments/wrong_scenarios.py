"""Scenarios with one mistake each, for the tests of `concord check`."""

from dataclasses import replace

import numpy as np

from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.plants.own_truth import OwnTruth, sensors_of_nodes
from concord.plants.placement import Draws, GeneratorFor
from concord.scenarios.catalogue import definition_of
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.scenario_definition import ScenarioDefinition

MATRIX = np.array([[1.0, 0.1], [0.0, 0.95]])
PLANT = OwnPlant(f=lambda x: x @ MATRIX.T, Q=[1e-4, 1e-2], mean=[0, 0], cov=[4, 4])
PLACE = OwnSensor(h=lambda x: x[..., :1], R=0.01)
SPEED = OwnSensor(h=lambda x: x[..., 1:], R=0.01)
SENSED = sensors_of_nodes(PLANT, [PLACE, None, PLACE, None, PLACE])
CALLS = [0.0]


def _definition(plant: OwnPlant = PLANT, sensor: OwnSensor = PLACE) -> ScenarioDefinition:
    return definition_of(own_scenario(plant, [sensor, None], nodes=4, steps=60))


def _jumping(x: np.ndarray) -> np.ndarray:
    """Read the first state; beyond 1 m, the largest of all lanes."""
    return np.where(x[..., :1] > 1, x[..., :1].max(), x[..., :1])


def _restless(x: np.ndarray) -> np.ndarray:
    CALLS[0] += 1e-9
    return x @ MATRIX.T + CALLS[0]


class OneStream(OwnTruth):
    """A truth that draws the noise of all nodes from one stream."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        drawn = super().draw(generator_for, steps)
        noise = generator_for("measurement", 0).standard_normal(drawn.measurement.shape)
        return drawn._replace(measurement=noise)


class Indefinite(OwnPlant):
    """A model whose process noise has a negative variance."""

    def process_noise_cov(self, step: int) -> np.ndarray:
        return np.diag([-1e-4, 1e-2])


CORRECT = own_scenario(PLANT, [PLACE, None], nodes=4, steps=60)
TRANSITION = _definition(replace(PLANT, f=lambda x: x @ MATRIX.T + np.maximum(x.max(), 1)))
SENSORS = _definition(sensor=OwnSensor(h=_jumping, R=0.01))
NOISE = _definition()._replace(
    model=lambda _: Indefinite(f=PLANT.f, Q=PLANT.Q, mean=PLANT.mean, cov=PLANT.cov)
)
DRAWS = _definition()._replace(plant=lambda scenario: OneStream(PLANT, SENSED[: scenario.nodes]))
AGREEMENT = own_scenario(replace(PLANT, f=_restless), [PLACE, None], nodes=4, steps=60)
CENTRALISED = _definition()._replace(model=lambda _: replace(PLANT, Q=[1e-8, 1e-6]))
OBSERVABLE = own_scenario(PLANT, [SPEED], nodes=2, steps=60)
