"""The scenarios by name."""

from scenarios.definitions import (
    control,
    liu2021_network,
    meng2025,
    meng2025_network,
    mrclam,
    oscillator,
    target_tracking,
    vehicle_network,
)
from scenarios.scenario_definition import ScenarioDefinition
from topology.names import unknown_name

_DEFINITIONS: dict[str, ScenarioDefinition] = {
    "target-tracking": target_tracking.TURNING,
    "target-crossing": target_tracking.CROSSING,
    "oscillator": oscillator.DEFINITION,
    "mrclam": mrclam.DEFINITION,
    **control.DEFINITIONS,
    "meng2025": meng2025.DEFINITION,
    "meng2025-network": meng2025_network.DEFINITION,
    "liu2021-network": liu2021_network.DEFINITION,
    "vehicle-network": vehicle_network.DEFINITION,
}


def definitions() -> dict[str, ScenarioDefinition]:
    """All scenarios by name."""
    return dict(_DEFINITIONS)


def definition_of(name: str) -> ScenarioDefinition:
    """The scenario of that name.

    Raises:
        ValueError: there is none.
    """
    if name not in _DEFINITIONS:
        raise unknown_name("scenario", name, _DEFINITIONS)
    return _DEFINITIONS[name]
