"""`concord list`: what there is to choose from."""

import sys
from dataclasses import dataclass
from typing import Annotated

import msgspec
import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from concord.entries import summaries
from concord.nodes.faults.vocabulary import EVERY_FAULT, usage
from concord.scenarios.bus_table.bus_plan import arbiter_names, schedule_names
from concord.scenarios.bus_table.clusters import cluster_names
from concord.scenarios.catalogue import definitions
from concord.scenarios.scenario_definition import ScenarioDefinition
from concord.scenarios.scenario_options import offered_options
from concord.scenarios.types.option import name_of
from concord.scenarios.types.schedules import WrittenSchedule
from concord.topology.choices import WEIGHTS, graph_names
from concord.topology.link_names import NAMES as LINK_NAMES


@dataclass(frozen=True)
class ListOptions:
    """How to show it."""

    json: bool = False
    """Print one JSON object instead of tables."""


def list_all(options: Annotated[ListOptions, tyro.conf.arg(name="")]) -> None:
    """List scenarios, rules, filters, faults, and names that options of network and bus take."""
    names = {
        "graphs": list(graph_names()),
        "weights": list(WEIGHTS),
        "links": list(LINK_NAMES),
        "schedules": [*schedule_names(), name_of(WrittenSchedule)],
        "clusters": list(cluster_names()),
        "arbiters": list(arbiter_names()),
        "holds": list(offered_options()["hold"].names),
        "buses": list(offered_options()["bus"].names),
    }
    own = {
        name: {"rule": tuple(definition.wirings), **wiring.names}
        for name, definition in definitions().items()
        for wiring in definition.wirings.values()
    }
    if options.json:
        scenarios = {
            name: definition.defaults.with_(steps=_steps(definition) or definition.defaults.steps)
            for name, definition in definitions().items()
        }
        faults = {word: fault.summary for word, fault in EVERY_FAULT.items()}
        everything = {
            "scenarios": scenarios, "rules": summaries("RULES"),
            "filters": summaries("FILTERS"), **names,
            "own": own, "faults": faults,
        }  # fmt: skip
        sys.stdout.write(msgspec.json.encode(everything).decode() + "\n")
        return
    console = Console()
    scenarios = Table("scenario", "what it is", "nodes", "graph", "steps")
    for name, definition in definitions().items():
        d = definition.defaults
        scenarios.add_row(
            name,
            type(d.plant).summary(),
            str(d.nodes),
            d.network.graph,
            str(_steps(definition) or "as --data"),
        )
    console.print(scenarios)
    faults = {escape(usage(word)): fault.summary for word, fault in EVERY_FAULT.items()}
    for what, meaning, described in (
        ("rule", "what it promises", summaries("RULES")),
        ("filter", "what it is", summaries("FILTERS")),
        ("fault", "what happens", faults),
    ):
        table = Table(what, meaning)
        for name, summary in described.items():
            table.add_row(name, summary)
        console.print(table)
    for what, values in names.items():
        console.print(f"{what}: {', '.join(values)}", highlight=False, soft_wrap=True)
    for name, of_option in own.items():
        values = "; ".join(f"--{option} {', '.join(of)}" for option, of in of_option.items())
        console.print(f"{name} has its own: {values}", highlight=False, soft_wrap=True)


def _steps(definition: ScenarioDefinition) -> int | None:
    """Steps of a scenario when nothing is asked for; None where its data must be named first."""
    if definition.all_steps is None:
        return definition.defaults.steps
    try:
        return definition.all_steps(definition.defaults)
    except ValueError:
        return None
