"""`target-swarm`: several targets that come and go, under sensors with misses and clutter.

The ground, the sensors and the radio are those of `target-tracking`. Detections carry no target.
The state of a belief is the number of targets; an estimate carries the tracks beside it.
"""

from dataclasses import dataclass

import numpy as np

from concord.plants.scanning import ScanningSensor
from concord.scenarios.definitions.swarm_tracking import (
    baseline_filter,
    estimator,
    model_of,
    plant_of,
    scan_codec_of,
    share_bytes,
)
from concord.scenarios.definitions.target_tracking import RADIO_RANGE_M
from concord.scenarios.labelled import check_labelled
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import NetworkWiring, ScenarioDefinition, Score
from concord.scenarios.setup import Setup
from concord.scenarios.types.filters import UnscentedFilter
from concord.scenarios.types.network import SensorNetwork
from concord.scenarios.types.plants import TargetSwarm
from concord.scenarios.types.rules import MeasurementFlooding, TrackIntersection

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
    rule = scenario.rule
    require(
        isinstance(rule, MeasurementFlooding | TrackIntersection),
        "rule",
        rule.name,
        "labelled or track-ci: nodes of target-swarm flood their scans or share their tracks",
    )
    require(
        isinstance(scenario.filter, UnscentedFilter),
        "filter",
        scenario.filter.name,
        "ukf: the tracker predicts and updates each track by it",
    )
    # Placing the nodes is what can fail, and says why.
    plant_of(scenario)
    if isinstance(rule, MeasurementFlooding):
        _check_flooding(scenario, rule)


def _check_flooding(scenario: Scenario, rule: MeasurementFlooding) -> None:
    why = "a record is a scan, and its tracker judges the detections"
    require(rule.record_number == "int16", "record-number", rule.record_number, f"int16: {why}")
    for option in ("gate_probability", "withhold_below", "smooth_steps"):
        value = getattr(rule, option)
        require(value == 0, option, value, f"0: {why}")
    # Finding room for a detection is what else can fail, and says why.
    scan_codec_of(scenario)


def _check_network(setup: Setup) -> None:
    if isinstance(setup.scenario.rule, MeasurementFlooding):
        check_labelled(setup.scenario, setup.neighbours, None)


def _without_arrays(scenario: Scenario) -> str | None:
    return "target-swarm"


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
    wiring=NetworkWiring(
        schedule=None,
        share_bytes=share_bytes,
        estimator=estimator,
        batched=None,
        names={"rule": ("labelled", "track-ci")},
        check=_check_network,
        lacking=_without_arrays,
    ),
    baseline_filter=baseline_filter,
)
