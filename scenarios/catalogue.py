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
from scenarios.kind import ScenarioDefinition
from topology.names import unknown_name

_KINDS: dict[str, ScenarioDefinition] = {
    "target-tracking": target_tracking.TURNING,
    "target-crossing": target_tracking.CROSSING,
    "oscillator": oscillator.KIND,
    "mrclam": mrclam.KIND,
    **control.KINDS,
    "meng2025": meng2025.KIND,
    "meng2025-network": meng2025_network.KIND,
    "liu2021-network": liu2021_network.KIND,
    "vehicle-network": vehicle_network.KIND,
}


def kinds() -> dict[str, ScenarioDefinition]:
    """All scenarios by name."""
    return dict(_KINDS)


def kind_of(name: str) -> ScenarioDefinition:
    """The scenario of that name.

    Raises:
        ValueError: there is none.
    """
    if name not in _KINDS:
        raise unknown_name("scenario", name, _KINDS)
    return _KINDS[name]
