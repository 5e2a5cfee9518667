"""`target-swarm`: several targets that come and go, under sensors with misses and clutter.

The ground, the sensors and the radio are those of `target-tracking`. Detections carry no target.
The state of a belief is the number of targets; an estimate carries the tracks beside it.
"""

from dataclasses import dataclass

import numpy as np

from concord.features.several_targets.options import TargetSwarm
from concord.features.several_targets.scanning import ScanningSensor
from concord.features.several_targets.swarm_scans import FLOODED_SCANS
from concord.features.several_targets.swarm_tracking import baseline_filter, model_of, plant_of
from concord.features.several_targets.swarm_tracks import SHARED_TRACKS
from concord.scenarios.definitions.target_tracking import RADIO_RANGE_M
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.filters import InteractingMultipleModels, UnscentedFilter
from concord.scenarios.types.plants import SensorNetwork
from concord.scenarios.types.rules import MeasurementFlooding

# Birth and the first confirmation of the targets that are there from the start.
_SETTLED_STEPS = 0
_WINDOW_STEPS, _ROUNDS = 8, 16


@dataclass(frozen=True)
class DetectionSensor:
    """The rows of a scan as readings; no state of the plant gives them."""

    scanning: ScanningSensor

    gate = None

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return NaN (..., 2): the number of targets tells of no detection."""
        return np.full((*state.shape[:-1], 2), np.nan)

    def residual(self, value: np.ndarray, predicted: np.ndarray, /) -> np.ndarray:
        """The difference of two detections (..., 2), their bearing within half a turn."""
        return self.scanning.residual(value, predicted)

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a row (..., 2) as it is, and its noise: 0 for the number of detections."""
        is_number = np.isnan(delivered[..., 1])[..., None, None]
        return delivered, np.where(is_number, 0.0, self.scanning.noise_cov)


def _check(scenario: Scenario) -> None:
    require(
        isinstance(scenario.filter, UnscentedFilter | InteractingMultipleModels),
        "filter",
        scenario.filter.name,
        "ukf or imm: the tracker predicts and updates each track by it",
    )
    # Placing the nodes is what can fail, and says why.
    plant_of(scenario)


DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=TargetSwarm(),
        network=SensorNetwork(nodes=20, graph="geometric"),
        # Scans differ in length, so each may be as long as a frame allows.
        rule=MeasurementFlooding(window_steps=_WINDOW_STEPS, payload_bytes=254),
        rounds=_ROUNDS,
        steps=100,
    ),
    check=_check,
    plant=plant_of,
    model=model_of,
    sensor=lambda scenario, node: DetectionSensor(plant_of(scenario).sensors[node]),
    score=Score(states=(0,), unit="m", nees_states=(0,), first_step=_SETTLED_STEPS),
    radio_range_m=RADIO_RANGE_M,
    wirings={"labelled": FLOODED_SCANS, "track-ci": SHARED_TRACKS},
    baseline_filter=baseline_filter,
    results="concord.features.several_targets.results:EXTRAS",
    page="concord.features.several_targets.page:PAGE",
)
