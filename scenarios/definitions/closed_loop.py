"""The node whose estimate drives the controller of a scenario's plant."""

from concord.scenarios.scenario import Scenario
from concord.scenarios.types.plants import ControlledPlant


def control_node(scenario: Scenario) -> int | None:
    """The node whose estimate closes the loop; None where no estimate does."""
    plant = scenario.plant
    if not isinstance(plant, ControlledPlant) or not plant.control.isdigit():
        return None
    return int(plant.control)
