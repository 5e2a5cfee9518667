"""The scenarios by name."""

from functools import lru_cache

import numpy as np

from concord.entries import chosen, entries
from concord.filters.metrics import nees
from concord.filters.turns import angles_of, beside
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition
from concord.scenarios.types.plants import UserPlant
from concord.scenarios.user.values import ValueSource, is_source_name, source_of
from concord.topology.names import unknown_name


def definitions() -> dict[str, ScenarioDefinition]:
    """All scenarios by name; loads every one of them."""
    return {name: definition_named(name) for name in entries("SCENARIOS")}


def definition_of(scenario: Scenario) -> ScenarioDefinition:
    """The definition of a scenario's plant, sensors and models.

    Raises:
        ValueError: it is of a file that is not there, or is another one now.
    """
    plant = scenario.plant
    if isinstance(plant, UserPlant) and plant.where in _received:
        return _received[plant.where]
    where = plant if isinstance(plant, UserPlant) else scenario.name
    return _believed(where, scenario.identified) if scenario.identified else _definition(where)


def as_long_as(scenario: Scenario, steps: int) -> str:
    """Say how a run has so many steps: by the option, or by a longer log than this one."""
    all_steps = definition_of(scenario).all_steps
    longest = steps if all_steps is None else all_steps(scenario)
    if longest < steps:
        return f"a log of {steps} steps or more; this one has {longest}"
    return f"--steps {steps}"


_received: dict[ValueSource, ScenarioDefinition] = {}


def set_received(scenario: Scenario, definition: ScenarioDefinition | None) -> None:
    """Take this definition for an own scenario in place of its code; None for the code again."""
    assert isinstance(scenario.plant, UserPlant), "only own plants are code of a user"
    if definition is None:
        _received.pop(scenario.plant.where, None)
    else:
        _received[scenario.plant.where] = definition


def is_received(scenario: Scenario) -> bool:
    """Whether this process reads an own scenario without its code."""
    return isinstance(scenario.plant, UserPlant) and scenario.plant.where in _received


def _definition(where: UserPlant | str) -> ScenarioDefinition:
    return definition_named(where) if isinstance(where, str) else _of_user(where.where, where.data)


@lru_cache(maxsize=16)
def _believed(where: UserPlant | str, word: str) -> ScenarioDefinition:
    # Only here: most filters believe in their scenario as it is.
    from concord.scenarios.identified import believed
    from concord.scenarios.types.identified_values import values_in

    return believed(_definition(where), values_in(word))


def _of_user(source: ValueSource, data: str | None = None) -> ScenarioDefinition:
    # Only here: most processes have no plant of the user's own.
    from concord.scenarios.definitions.own import user_definition

    return user_definition(source, data)


def scored_nees(scenario: Scenario, errors: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """NEES (...) of errors (..., n) with cov (..., n, n) in the states of `Score.nees_states`.

    A reading that stands for the truth has an error of its own, whose covariance is added.
    """
    definition = definition_of(scenario)
    states = list(definition.score.nees_states)
    if states != list(range(errors.shape[-1])):
        errors, cov = errors[..., states], cov[..., states, :][..., states]
    return nees(errors, cov + definition.reference_cov(scenario))


def beside_truth(scenario: Scenario, mean: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Means (..., n) whose angles are on the turn next to the truth (..., n), so that their
    difference is the error; the same for a plant without angles."""
    angles = angles_of(definition_of(scenario).model(scenario))
    return beside(mean, truth, angles) if angles else mean


def definition_named(name: str) -> ScenarioDefinition:
    """The definition of that name, or in that file (FILE.py:NAME).

    Raises:
        ValueError: there is none.
    """
    if is_source_name(name):
        return _of_user(source_of(name))
    if name not in entries("SCENARIOS"):
        raise unknown_name("scenario", name, entries("SCENARIOS"))
    found = chosen("SCENARIOS", name)
    if not isinstance(found, ScenarioDefinition):
        raise ValueError(
            f"scenario {name!r}: its entry is a {type(found).__name__}; make it a "
            "ScenarioDefinition (docs/adding_a_scenario.md)"
        )
    return found
