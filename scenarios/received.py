"""Own scenarios of received runs: names, units and scored states of run.json, and no code.

A folder of results may come from anywhere, so its readers load no plant of it. Figures that need
the model are unknown then: those of the filter that hears everything, and of nodes alone.
"""

from typing import Any, NoReturn

import msgspec
import numpy as np

from concord.filters.turns import angles_of
from concord.scenarios.catalogue import definition_of, set_received
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score


class States(msgspec.Struct, frozen=True):
    """Names, units and scored states, which readers show of a plant without its code.

    Attributes:
        names, units: of each state.
        scored, unit, nees_states, first_step, near_s: as a `Score` has them.
        places: (N, 2 or 3) of the nodes in the first step, in m; None without.
        blind: nodes without a sensor.
        all_steps: steps of a log; None for a simulated truth.
        angles: states that are angles.
    """

    names: list[str]
    units: list[str]
    scored: list[int]
    unit: str
    nees_states: list[int]
    first_step: int
    near_s: float | None = None
    places: list[list[float]] | None = None
    blind: list[int] = []
    all_steps: int | None = None
    angles: list[int] = []

    def __post_init__(self) -> None:
        """Check that all parts are of one plant.

        Raises:
            ValueError: other numbers of units, or a scored state that is not there.
        """
        known = range(len(self.names))
        if len(self.units) != len(self.names):
            raise ValueError(f"{len(self.units)} units of {len(self.names)} states")
        if not all(state in known for state in (*self.scored, *self.nees_states, *self.angles)):
            raise ValueError(f"scored states {self.scored} of {len(self.names)} states")


def states_of(scenario: Scenario) -> States:
    """Return what readers show of a scenario's plant."""
    definition = definition_of(scenario)
    plant, score = definition.plant(scenario), definition.score
    places = plant.positions(0)
    return States(
        list(plant.state_names),
        list(plant.state_units),
        list(score.states),
        score.unit,
        list(score.nees_states),
        score.first_step,
        score.near_s,
        None if places is None else np.asarray(places).tolist(),
        [node for node in range(scenario.nodes) if definition.sensor(scenario, node) is None],
        None if definition.all_steps is None else definition.all_steps(scenario),
        list(angles_of(definition.model(scenario))),
    )


class _Refused:
    """A model or sensor whose code is not loaded: each use is refused."""

    def __init__(self, refusal: ValueError, angles: tuple[int, ...] = ()) -> None:
        self._refusal, self.angles = refusal, angles

    def __getattr__(self, name: str) -> NoReturn:
        raise self._refusal


class _ReceivedPlant:
    """The names of a plant whose code is not loaded."""

    def __init__(self, states: States, time_step_s: float, refusal: ValueError) -> None:
        self.time_step_s, self.refusal = time_step_s, refusal
        self.state_names, self.state_units = tuple(states.names), tuple(states.units)
        self._places = None if states.places is None else np.array(states.places)

    def positions(self, step: int) -> np.ndarray | None:
        """Return where the nodes are; they are taken to stay where they began."""
        return self._places

    def refuse(self, *_: object) -> NoReturn:
        """Refuse what needs the plant's code."""
        raise self.refusal

    draw = initial = advance = observe = refuse


def receive(scenario: Scenario, states: States, time_step_s: float, refusal: ValueError) -> None:
    """Let this process read runs of an own scenario without its code; what needs it is refused."""
    plant: Any = _ReceivedPlant(states, time_step_s, refusal)
    steps = states.all_steps
    refused: Any = _Refused(refusal)
    model: Any = _Refused(refusal, tuple(states.angles))
    set_received(
        scenario,
        ScenarioDefinition(
            defaults=scenario,
            check=lambda _: None,
            plant=lambda _: plant,
            model=lambda _: model,
            sensor=lambda _, node: None if node in states.blind else refused,
            score=Score(
                tuple(states.scored),
                states.unit,
                tuple(states.nees_states),
                states.first_step,
                states.near_s,
            ),
            all_steps=None if steps is None else lambda _: steps,
            is_received=True,
        ),
    )
