"""Closed loop of a scenario: whose estimate drives the controller of its plant."""

from concord.scenarios.scenario import Scenario
from concord.scenarios.types.plants import ControlledPlant

OPEN, TRUTH = "open", "truth"


def controlled(scenario: Scenario) -> ControlledPlant:
    """The plant of a scenario that has a controller."""
    assert isinstance(scenario.plant, ControlledPlant), "the catalogue chose this file"
    return scenario.plant


def control_node(scenario: Scenario) -> int | None:
    """The node whose estimate closes the loop; None where no estimate does."""
    plant = scenario.plant
    if not isinstance(plant, ControlledPlant) or not plant.control.isdigit():
        return None
    return int(plant.control)


def check_control(scenario: Scenario) -> None:
    """Refuse a --control that there is not.

    Raises:
        ValueError: naming the option, its value, and what there is.
    """
    node, control = control_node(scenario), controlled(scenario).control
    if node is None and control not in (OPEN, TRUTH):
        raise ValueError(
            f"--control {control}: must be the number of a node, {TRUTH!r} or {OPEN!r}"
        )
    if node is not None and node >= scenario.nodes:
        raise ValueError(
            f"--control {node}: there are nodes 0 to {scenario.nodes - 1}; choose one of them"
        )
