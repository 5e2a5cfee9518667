"""Scenarios of the user's own: a plant and sensors given as functions and covariances."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from concord.plants.own_plant import OwnPlant
from concord.plants.own_truth import (
    NodeSensors,
    OwnTruth,
    Sensed,
    TruePlant,
    sensors_of_nodes,
)
from concord.plants.recorded.log_file import while_files_stay
from concord.scenarios.definitions.late_readings import refuse_late
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Declared, ScenarioDefinition, Score
from concord.scenarios.types.option import Choice, require_kind
from concord.scenarios.types.plants import SensorNetwork, UserPlant
from concord.scenarios.user.values import (
    FromFile,
    ValueSource,
    kept_source,
    named_source,
    value_of,
)

if TYPE_CHECKING:
    from concord.plants.own_readings import OwnReplay


def own_scenario(
    plant: OwnPlant,
    sensors: Sequence[Sensed],
    *,
    truth: TruePlant | None = None,
    readings: Any = None,
    nodes: int | None = None,
    graph: Any = "ring",
    steps: int | None = None,
    scored_states: Sequence[int] = (0,),
    first_scored_step: int = 20,
    radio_range_m: float | None = None,
    identified: str | Path = "",
) -> Scenario:
    """A scenario of a plant and sensors of your own; `Scenario.with_` changes its options.

    Args:
        plant: truth, and the model of every filter.
        sensors: dealt to the nodes in turn; a list for a node of several, None for a blind one.
        truth: what plant and sensors really do, where the filters believe something else.
        readings: of a log in place of simulated ones: a file, a folder with `columns.toml`, or an
            `xarray.Dataset` (docs/own_plant.md).
        nodes: number of nodes; one for each sensor when left out.
        graph: who hears whom, as in `--graph`, or a graph of networkx or a matrix.
        steps: sampling instants; 200, or those of the log, when left out.
        scored_states: states of the RMSE, all of one unit.
        first_scored_step: scored from here on, so that the start does not rule the figures.
        radio_range_m: reach of a node in the geometric graph of a plant with positions.
        identified: file of `concord identify`, whose noise, delays and parameters the filters take.

    Raises:
        ValueError: a sensor that cannot read the plant's states, states that it does not have, or
            readings that cannot be read.
    """
    require_kind("plant", plant, OwnPlant, "an OwnPlant")
    if truth is not None:
        require_kind("truth", truth, TruePlant, "a Truth")
    dealt = sensors_of_nodes(plant, sensors, truth)
    if readings is not None:
        _require_readings(len(dealt), truth, nodes)
    own = _OwnNetwork(plant, dealt, plant if truth is None else truth.plant_of(plant), readings)
    all_steps = None if own.log is None else own.log.steps
    asked = {"nodes": nodes, "graph": graph, "steps": all_steps if steps is None else steps}
    asked["identified"] = str(identified) or None
    given = {name: value for name, value in asked.items() if value is not None}
    network = SensorNetwork(nodes=len(dealt), graph="ring")
    definition = ScenarioDefinition(
        defaults=Scenario(plant=UserPlant(), network=network, steps=200).with_(**given),
        check=own.check,
        plant=lambda scenario: own.log or own.truth(scenario.nodes),
        model=lambda _: plant,
        sensor=lambda scenario, node: own.truth(scenario.nodes).sensor(node),
        late_steps=own.late_steps,
        irregular=lambda scenario: own.truth(scenario.nodes).irregular,
        all_steps=None if all_steps is None else lambda _: all_steps,
        score=own_score(plant.units, scored_states, first_scored_step),
        radio_range_m=radio_range_m,
        origin=lambda _: plant.prior_mean,
        declared=lambda scenario: own.declared(sensors, scenario.nodes),
    )
    definition = definition._replace(with_data=partial(_with_data, own))
    return user_definition(kept_source(definition)).defaults


@dataclass(frozen=True, eq=False)
class _OwnNetwork:
    """A plant as the filters believe it, the sensors dealt to the nodes in turn, the plant that
    really moves, and the readings that stand for it; None for none. `usual` are those that the
    user's file names, where others stand."""

    plant: OwnPlant
    dealt: tuple[NodeSensors | None, ...]
    moving: OwnPlant
    readings: Any
    usual: Any = None

    @cached_property
    def log(self) -> "OwnReplay | None":
        """The plant that delivers the readings."""
        if self.readings is None:
            return None
        # Only here: a simulated plant needs no reader of logs.
        from concord.plants.own_readings import replayed

        return replayed(self.plant, self.dealt, self.readings, self.usual)

    @lru_cache  # noqa: B019  a scenario lives as long as its process
    def truth(self, nodes: int) -> OwnTruth:
        """The truth with so many nodes."""
        sensors = tuple(self.dealt[node % len(self.dealt)] for node in range(nodes))
        return OwnTruth(self.moving, sensors, self.plant)

    def declared(self, sensors: Sequence[Sensed], nodes: int) -> Declared | None:
        """The plant's parameters, and model and sensors with other values of them."""
        if not self.plant.parameters:
            return None

        @lru_cache
        def bound(values: tuple[tuple[str, float], ...]) -> Any:
            plant = self.plant.with_values(dict(values))
            of_nodes = [one and one.sensor for one in sensors_of_nodes(plant, sensors)]
            return plant, [of_nodes[node % len(of_nodes)] for node in range(nodes)]

        return Declared(self.plant.parameters, lambda values: bound(tuple(values.items())))

    def late_steps(self, scenario: Scenario) -> tuple[int, ...]:
        """After how many steps each node has its readings; empty where all come at once."""
        own = self.truth(scenario.nodes)
        late = tuple(own.late_steps(node) for node in range(scenario.nodes))
        return late if any(late) else ()

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario that plant, sensors or log cannot be in.

        Raises:
            ValueError: naming the option, its value and the cure.
        """
        own = self.truth(scenario.nodes)
        own.positions(0)
        own.require_inputs(scenario.steps)
        if self.log is not None:
            _check_log(scenario, self.log)
        refuse_late(
            scenario, self.late_steps(scenario), "the gate of late sensors" * own.gated, "delay_s"
        )


def _with_data(own: _OwnNetwork, definition: ScenarioDefinition, data: str) -> ScenarioDefinition:
    """The definition with the readings of a log, which is read where a run needs it."""
    read = while_files_stay(lambda path: replace(own, readings=path, usual=own.readings))

    def log() -> "OwnReplay":
        found = read(data).log
        assert found is not None, "it has readings"
        return found

    return definition._replace(
        check=lambda scenario: read(data).check(scenario),
        plant=lambda _: log(),
        all_steps=lambda _: log().steps,
    )


def _require_readings(dealt: int, truth: TruePlant | None, nodes: int | None) -> None:
    if truth is not None:
        raise ValueError("truth: readings have a truth of their own; leave one of the two out")
    if nodes not in (None, dealt):
        raise ValueError(
            f"nodes {nodes}: the readings are of {dealt} nodes, one for each of sensors; leave "
            "nodes out"
        )


def _check_log(scenario: Scenario, log: "OwnReplay") -> None:
    nodes = log.readings.shape[1]
    if scenario.nodes != nodes:
        raise ValueError(
            f"--nodes {scenario.nodes}: the log has readings of {nodes} nodes, one for each entry "
            f"of sensors; give --nodes {nodes}"
        )
    if scenario.steps > log.steps:
        raise ValueError(
            f"--steps {scenario.steps}: the log has {log.steps} steps of {log.time_step_s:g} s; "
            "ask for fewer, or leave --steps out"
        )


def own_score(state_units: Sequence[str], scored_states: Sequence[int], first_step: int) -> Score:
    """The score of some states of a plant, and of the NEES of all.

    Raises:
        ValueError: no state, one that the plant does not have, or states of different units.
    """
    n = len(state_units)
    require_kind("scored_states", scored_states, Sequence, "a tuple of numbers of states")
    require_kind("first_scored_step", first_step, int, "a whole number")
    if not scored_states or any(state not in range(n) for state in scored_states):
        raise ValueError(f"scored_states {tuple(scored_states)}: must be some of 0 to {n - 1}")
    units = {state_units[state] for state in scored_states}
    if len(units) > 1:
        raise ValueError(
            f"scored_states {tuple(scored_states)}: they have units {sorted(units)}; score states "
            "of one unit"
        )
    return Score(tuple(scored_states), min(units), tuple(range(n)), first_step)


def portable(scenario: Scenario) -> Scenario:
    """The scenario with its own plant, rule, bus and filter by their names in files, so that other
    processes find them; unchanged where they have such names.

    Raises:
        ValueError: only this session has them.
    """
    plant = scenario.plant
    if isinstance(plant, UserPlant):
        where, simulated = plant.where, UserPlant.of(plant.where)
        named = named_source(
            where, lambda value: isinstance(value, Scenario) and value.plant in (plant, simulated)
        )
        plant = msgspec.structs.replace(plant, source=named.name, digest=named.digest)
    return msgspec.structs.replace(
        scenario,
        plant=plant,
        rule=_named(scenario.rule),
        bus=_named(scenario.bus),
        filter=_named(scenario.filter),
    )


def _named(choice: Choice) -> Choice:
    if not isinstance(choice, FromFile):
        return choice
    kept = value_of(choice.where)
    source = named_source(choice.where, lambda value: value is kept)
    return msgspec.structs.replace(choice, source=source.name, digest=source.digest)


@lru_cache
def user_definition(source: ValueSource, data: str | None = None) -> ScenarioDefinition:
    """The definition of a scenario of the user's own, with the readings of a log if one is named.

    Raises:
        ValueError: there is no such value, it is no scenario, or it takes no readings.
    """
    definition = value = value_of(source)
    usual = None
    if isinstance(value, Scenario) and isinstance(value.plant, UserPlant):
        # The file made it under a number of its session; here it goes by its name in the file.
        definition = user_definition(value.plant.where)._replace(defaults=value)
        usual = value.plant.data
    if not isinstance(definition, ScenarioDefinition):
        raise ValueError(
            f"{source.name}: it is a {type(value).__name__}; it must be a scenario, as "
            "own_scenario(...) returns"
        )
    plant = UserPlant(source=source.name, digest=source.digest, data=usual)
    data = data or usual
    if data is not None:
        if definition.with_data is None:
            raise ValueError(
                f"--data {data}: {source.name} takes no readings of a log, as own_scenario(...) "
                "does; leave --data out"
            )
        definition = definition.with_data(definition, data)
    return definition._replace(defaults=msgspec.structs.replace(definition.defaults, plant=plant))
