"""The truth of a run is worked out before the start, to find sensors that read nothing."""

from functools import partial

import numpy as np

from concord.nodes.messages import from_wire
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup, generator
from concord.scenarios.types.plants import PlacedSensors, UserPlant

# Readings that are looked at for infinite ones, once a sensor has read something.
_MOST_READINGS = 4000


def check_readings(setup: Setup) -> None:
    """Refuse a run in whose first steps a sensor of the user reads infinity, or in which no sensor
    of an own plant, or at sites that were given, ever reads anything.

    A function of the user that fails, and a truth that is not finite, end this without a word: the
    run tells of both. Sensors that are moved in the run may read then.

    Raises:
        ValueError: naming node, step and reading, or the number of steps.
    """
    scenario = setup.scenario
    definition = definition_of(scenario)
    if not _is_asked(scenario) or definition.wirings or definition.delivery is not None:
        return
    plant = definition.plant(scenario)
    draws = plant.draw(partial(generator, scenario), scenario.steps)
    state, seen, looked = from_wire(setup.initial_state), False, 0
    for step in range(scenario.steps):
        try:
            with np.errstate(all="ignore"):
                if step > 0:
                    state = plant.advance(state, None, draws.process[step - 1], step - 1)
                readings = plant.observe(state, draws.measurement[step], step)
        # Code of the user may fail in any way.
        except Exception:
            return
        if not np.isfinite(state).all():
            return
        if (infinite := np.argwhere(np.isinf(readings))).size:
            node = int(infinite[0][0])
            raise ValueError(
                f"node {node}: its sensor reads {readings[tuple(infinite[0])]} at step {step}, "
                f"where the state is {np.round(state, 6).tolist()}; a reading is a finite number, "
                "or NaN where none is taken"
            )
        seen, looked = seen or bool(np.isfinite(readings).any()), looked + scenario.nodes
        if seen and looked > _MOST_READINGS:
            return
    moved = any("placement" in change for change in scenario.changes)
    if not seen and not moved:
        cure = "move the sites" if isinstance(scenario.plant, PlacedSensors) else "correct h"
        raise ValueError(
            f"no sensor ever reads anything in the {scenario.steps} steps of run {scenario.run}; "
            f"{cure}, or use more --steps"
        )


def _is_asked(scenario: Scenario) -> bool:
    """Whether the user brought the plant, or gave the sites of its sensors."""
    plant = scenario.plant
    return isinstance(plant, UserPlant) or (
        isinstance(plant, PlacedSensors) and isinstance(plant.placement, str)
    )
