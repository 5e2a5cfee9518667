"""The scenarios by name."""

import numpy as np

from concord.features.control import scenario as control
from concord.features.measurement_bus import meng2025, meng2025_network
from concord.features.recorded import scenario as mrclam
from concord.features.sets import liu2021, liu2021_network
from concord.features.several_targets import scenario as target_swarm
from concord.features.vehicle import scenario as vehicle_network
from concord.filters.metrics import nees
from concord.scenarios.definitions import oscillator, own, target_tracking
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition
from concord.scenarios.types.plants import UserPlant
from concord.scenarios.user.values import is_source_name, source_of
from concord.topology.names import unknown_name

_DEFINITIONS: dict[str, ScenarioDefinition] = {
    "target-tracking": target_tracking.TURNING,
    "target-crossing": target_tracking.CROSSING,
    "target-swarm": target_swarm.DEFINITION,
    "oscillator": oscillator.DEFINITION,
    "mrclam": mrclam.DEFINITION,
    **control.DEFINITIONS,
    "meng2025": meng2025.DEFINITION,
    "meng2025-network": meng2025_network.DEFINITION,
    "liu2021": liu2021.DEFINITION,
    "liu2021-network": liu2021_network.DEFINITION,
    "vehicle-network": vehicle_network.DEFINITION,
}


def definitions() -> dict[str, ScenarioDefinition]:
    """All scenarios by name."""
    return dict(_DEFINITIONS)


def definition_of(scenario: Scenario) -> ScenarioDefinition:
    """The definition of a scenario's plant, sensors and models.

    Raises:
        ValueError: it is of a file that is not there, or is another one now.
    """
    if isinstance(scenario.plant, UserPlant):
        return own.user_definition(scenario.plant.where)
    return _DEFINITIONS[scenario.name]


def scored_nees(scenario: Scenario, errors: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """NEES (...) of errors (..., n) with cov (..., n, n) in the states of `Score.nees_states`.

    A reading that stands for the truth has an error of its own, whose covariance is added.
    """
    definition = definition_of(scenario)
    states = list(definition.score.nees_states)
    if states != list(range(errors.shape[-1])):
        errors, cov = errors[..., states], cov[..., states, :][..., states]
    return nees(errors, cov + definition.reference_cov(scenario))


def definition_named(name: str) -> ScenarioDefinition:
    """The definition of that name, or in that file (FILE.py:NAME).

    Raises:
        ValueError: there is none.
    """
    if is_source_name(name):
        return own.user_definition(source_of(name))
    if name not in _DEFINITIONS:
        raise unknown_name("scenario", name, _DEFINITIONS)
    return _DEFINITIONS[name]
