"""The plant of a run in which sensors moved: in each step it measures from where they were."""

from collections.abc import Iterable

import msgspec

from concord.plants.placement import site_text, stands_by_step, word_by_step
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import scripted_settings
from concord.scenarios.setup import Setup
from concord.scenarios.types.plants import PlacedSensors


def with_moves(setup: Setup, moves: Iterable[tuple[int, str]]) -> Setup:
    """Return the setup whose sensors stand from these steps on at these sites, each one word."""
    plant, later = setup.scenario.plant, list(moves)
    if not later or not isinstance(plant, PlacedSensors):
        return setup
    first = definition_of(setup.scenario).plant(setup.scenario).positions(0)
    assert first is not None, "the plant has a placement"
    moving = msgspec.structs.replace(plant, placement=word_by_step(site_text(first), later))
    scenario = msgspec.structs.replace(setup.scenario, plant=moving)
    return msgspec.structs.replace(setup, scenario=scenario)


def with_scripted_moves(setup: Setup) -> Setup:
    """Return the setup whose sensors move as its script says, or one of `with_moves` as it is."""
    plant = setup.scenario.plant
    if not isinstance(plant, PlacedSensors) or stands_by_step(plant.placement):
        return setup
    standing = scripted_settings(setup)
    return with_moves(
        setup, [(step, str(some["placement"])) for step, some in standing if "placement" in some]
    )
