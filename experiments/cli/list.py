"""`concord list`: what there is to choose from."""

import sys
from dataclasses import dataclass
from typing import Annotated

import msgspec
import tyro
from rich.console import Console
from rich.table import Table

from concord.bus.arbitration import ARBITERS
from concord.entries import entries, summaries
from concord.experiments.standard_output import plain_console
from concord.scenarios.bus_table.clusters import cluster_names
from concord.scenarios.types.schedules import WrittenSchedule
from concord.topology.link_names import NAMES as LINK_NAMES
from concord.topology.names import WEIGHTS, graph_names


@dataclass(frozen=True)
class ListOptions:
    """How to show it."""

    json: bool = False
    """Print one JSON object instead of tables, with the defaults of each scenario."""
    faults: bool = False
    """List the words of faults alone."""


def list_all(options: Annotated[ListOptions, tyro.conf.arg(name="")]) -> None:
    """List scenarios, rules, filters, faults, and names that options of network and bus take."""
    if options.json:
        sys.stdout.write(msgspec.json.encode(_everything()).decode() + "\n")
        return
    console = plain_console()
    if options.faults:
        _show(console, "fault", "what happens", _faults())
        return
    for what, meaning, kind in (
        ("scenario", "what it is", "SCENARIOS"),
        ("rule", "what it promises", "RULES"),
        ("filter", "what it is", "FILTERS"),
    ):
        _show(console, what, meaning, summaries(kind))
    for what, values in _names().items():
        console.print(f"{what}: {', '.join(values)}", soft_wrap=True)
    console.print("faults: `concord list --faults`")


def _show(console: Console, what: str, meaning: str, sentences: dict[str, str]) -> None:
    table = Table(what, meaning)
    for name, sentence in sentences.items():
        table.add_row(name, sentence)
    console.print(table)


def _names() -> dict[str, list[str]]:
    """Return the names that options take, from tables of names alone."""
    return {
        "graphs": list(graph_names()),
        "weights": list(WEIGHTS),
        "links": list(LINK_NAMES),
        "schedules": [*entries("SCHEDULES"), str(WrittenSchedule.__struct_config__.tag)],
        "clusters": list(cluster_names()),
        "arbiters": [*ARBITERS, *entries("ARBITERS")],
        "buses": list(entries("BUSES")),
    }


def _faults() -> dict[str, str]:
    # Only here: names and sentences need nothing of the nodes.
    from concord.nodes.faults.vocabulary import EVERY_FAULT, usage

    return {usage(word): fault.summary for word, fault in EVERY_FAULT.items()}


def _everything() -> dict[str, object]:
    # Only here: defaults need the definitions of all scenarios.
    from concord.nodes.faults.vocabulary import EVERY_FAULT
    from concord.scenarios.catalogue import definitions
    from concord.scenarios.scenario_options import offered_options

    scenarios, own = {}, {}
    for name, definition in definitions().items():
        defaults, steps = definition.defaults, None
        if definition.all_steps is not None:
            try:
                steps = definition.all_steps(defaults)
            except ValueError:
                steps = None  # Its data must be named first.
        scenarios[name] = defaults.with_(steps=steps or defaults.steps)
        for wiring in definition.wirings.values():
            own[name] = {"rule": tuple(definition.wirings), **wiring.names}
    return {
        "scenarios": scenarios,
        "rules": summaries("RULES"),
        "filters": summaries("FILTERS"),
        **_names(),
        "holds": list(offered_options()["hold"].names),
        "own": own,
        "faults": {word: fault.summary for word, fault in EVERY_FAULT.items()},
    }
