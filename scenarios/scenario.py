"""A scenario: everything that decides the numbers of a run, as one frozen value."""

from typing import TYPE_CHECKING, Annotated, Any, get_args

import msgspec
import numpy as np

from concord.entries import entries, member
from concord.scenarios.types.assignment import assigned, check_ranges, refuse_left
from concord.scenarios.types.buses import FlexRay, SharedBus, UserBus
from concord.scenarios.types.declarations import choice_of, every_option
from concord.scenarios.types.filters import FilterBase, UnscentedFilter, UserFilter
from concord.scenarios.types.option import Option, python_words
from concord.scenarios.types.plants import SensedPlantChoice, SensorNetwork, UserPlant
from concord.scenarios.types.rules import (
    AverageRule,
    CovarianceIntersection,
    FusionRule,
    UserRule,
)
from concord.scenarios.types.schedules import DynamicSchedule, FullSchedule
from concord.topology.names import is_file_name

if TYPE_CHECKING:
    PlantChoice = SensedPlantChoice
    RuleChoice = FusionRule
    BusChoice = SharedBus
    FilterChoice = FilterBase
else:
    PlantChoice = choice_of("SCENARIOS", UserPlant, base=SensedPlantChoice)
    RuleChoice = choice_of("RULES", UserRule, base=AverageRule)
    BusChoice = choice_of("BUSES", UserBus)
    FilterChoice = choice_of(
        "FILTERS", *get_args(choice_of("RECEIVERS", UserFilter)), base=FilterBase
    )


def bus_type(name: str) -> type[SharedBus]:
    """The class of a bus by its name; that of a user's bus for all other names."""
    known = entries("BUSES")
    return member(known[name].options) if name in known else UserBus


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The simulated case. Equal scenarios give equal numbers in every driver."""

    plant: Annotated[
        PlantChoice,
        Option("Which plant with its sensors; `concord list` names them; FILE.py:NAME is your own.",
               group="plant",
               flag="scenario", first=True),
    ]  # fmt: skip
    network: Annotated[SensorNetwork, Option("", group="network")]
    rule: Annotated[
        RuleChoice,
        Option("Fusion rule; FILE.py:NAME is your own.", group="rule", is_setting=True, first=True),
    ] = CovarianceIntersection()
    rounds: Annotated[
        int,
        Option("Consensus iterations per step, one communication cycle each.", group="rule",
               at_least=1, is_setting=True, first=True),
    ] = 3  # fmt: skip
    bus: Annotated[
        BusChoice,
        Option("Bus that the nodes share; FILE.py:NAME is your own.", group="bus", first=True),
    ] = FlexRay()
    filter: Annotated[
        FilterChoice,
        Option("Filter of the nodes; FILE.py:NAME is your own.", group="filter", first=True),
    ] = UnscentedFilter()
    identified: Annotated[
        str,
        Option("Noise, delays and parameters that filters believe in place of the scenario's: a "
               "file of `concord identify`, or NAME=VALUE;NAME=VALUE, such as R.gps=1.5.",
               group="filter"),
    ] = ""  # fmt: skip
    steps: Annotated[int, Option("Sampling instants to simulate.", at_least=1, first=True)]
    seed: Annotated[int, Option("Seed of everything random.", at_least=0, first=True)] = 1
    run: Annotated[
        int, Option("Number of the run in a Monte Carlo under one seed.", at_least=0)
    ] = 0
    changes: Annotated[
        tuple[str, ...],
        Option(
            'Changes to the network, each with its step: "10 kill 3" "20 restart 3" '
            '"25 cut 1 2" "30 heal 1 2" "40 loss 0.2" "50 corrupt 0.05" "60 set rule=hcmci '
            'rounds=2" (docs/faults.md has all words); file:PATH reads them from a file, one in '
            "each line.", group="faults", first=True,
        ),
    ] = ()  # fmt: skip

    @property
    def name(self) -> str:
        """Name of the plant with its sensors and models (`concord list`)."""
        return self.plant.name

    @property
    def nodes(self) -> int:
        """Number of sensor nodes."""
        return self.network.nodes

    @python_words()
    def with_(self, **options: Any) -> "Scenario":
        """The scenario with other options, each by its own name, wherever it is nested.

        A choice is given by its name or as a value: `with_(rule="labelled", window_steps=8)`.

        Raises:
            ValueError: an unknown option, one of a value that is not chosen, a wrong type, or a
                number out of its range.
        """
        changed, left = self.with_known(**options)
        refuse_left(changed, left)
        check_ranges(changed)
        return changed

    def with_known(self, **options: object) -> "tuple[Scenario, dict[str, object]]":
        """As `with_`, and the options that no chosen value has.

        Raises:
            ValueError: an unknown name, or a wrong type.
        """
        words = _with_schedule(self, in_words(options))
        found, left = assigned(self, words)
        # Two bytes a number by default give way to a filter that cannot have them.
        is_rounded = getattr(found.rule, "number", "") == "float16"
        if is_rounded and not found.filter.in_two_bytes and "number" not in words:
            return assigned(found, {"number": "float64", **left})
        return found, left


SETTINGS = tuple(
    dict.fromkeys(
        one.declaration.name for one in every_option(Scenario) if one.declaration.says.is_setting
    )
)
"""The options that a network can change while it runs."""


def in_words(options: dict[str, Any]) -> dict[str, Any]:
    """Options with plain numbers for those of numpy; a graph of networkx, a matrix, and sites as
    one word each, which say how many nodes there are, unless another option does.

    Raises:
        ValueError: a graph or a placement that is none.
    """
    plain = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in options.items()
    }
    if isinstance(plain.get("changes"), str):
        plain = {**plain, "changes": (plain["changes"],)}
    if plain.get("identified"):
        # Only here: most scenarios are believed as they are.
        from concord.scenarios.types.identified_values import in_one_word

        plain["identified"] = in_one_word(str(plain["identified"]))
    # Only here: a process of the network is handed the neighbours of its nodes.
    graph, placement = plain.get("graph"), plain.get("placement")
    if graph is not None and not isinstance(graph, str):
        from concord.topology.edge_text import sized_edge_text

        word, nodes = sized_edge_text(graph)
        plain = {"nodes": nodes, **plain, "graph": word}
    if is_file_name(graph) and "nodes" not in plain:
        from concord.topology.adjacency import nodes_of
        from concord.topology.graphs import build_network

        plain["nodes"] = nodes_of(build_network(graph, None, 0).adjacency)
    if placement is not None and not _is_drawing_or_sites(placement):
        from concord.plants.placement import site_text

        word = site_text(placement)
        plain = {"nodes": word.count(";") + 1, **plain, "placement": word}
    return plain


def _is_drawing_or_sites(placement: object) -> bool:
    return isinstance(placement, int) or (
        isinstance(placement, str) and not placement.startswith("file:")
    )


def _with_schedule(scenario: Scenario, options: dict[str, object]) -> dict[str, object]:
    """Choose the schedule of a slot table, an occupancy or another bus.

    An occupancy of 1 is the full one. A part of another bus, or of the full schedule, is the usual
    one of the bus.
    """
    if "slots" in options and "schedule" not in options:
        return {**options, "schedule": "written"}
    bus, schedule, asked = (options.get(name) for name in ("bus", "schedule", "occupancy"))
    if isinstance(bus, msgspec.Struct) or schedule not in (None, "full"):
        return options
    if asked == 1:
        rest = {name: value for name, value in options.items() if name != "occupancy"}
        return {**rest, "schedule": "full"}
    before, wish = scenario.bus.schedule, {"occupancy": asked} if asked is not None else {}
    if bus not in (None, scenario.bus.name) and isinstance(before, DynamicSchedule):
        wish = {"occupancy": before.occupancy, **wish}
    elif not isinstance(before, FullSchedule):
        return options
    if schedule is None and wish:
        # A part of the bus is a wish for a schedule that can give it.
        usual = bus_type(bus if isinstance(bus, str) else scenario.bus.name).partial_schedule
        return {**options, **wish, "schedule": usual}
    return options


def lossy_links(scenario: Scenario) -> str:
    """Why links do not bring every frame, in the words of the options; "" if they do."""
    network = scenario.network
    if network.loss > 0:
        return f"--loss {network.loss:g}"
    return "" if network.links == "static" else f"--links {network.links}"


def require(holds: bool, field: str, value: object, rule: str) -> None:
    """Raise a ValueError that names the option, its value and the rule unless it `holds`."""
    if not holds:
        raise ValueError(f"--{field.replace('_', '-')} {value}: must be {rule}")
