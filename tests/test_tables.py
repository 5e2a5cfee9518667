"""One table, one test: each entry of a table runs in every driver, or is refused in a sentence.

The test reads the declarations of a scenario and the tables of names, so a new entry is tried
without a new line here. Drivers that pass messages give equal bits, the batched one agrees to
1e-10. One entry of each group of options also runs over processes.
"""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, get_args

import msgspec
import numpy as np
import pytest

from concord.bus.arbitration import ARBITERS
from concord.nodes.faults.vocabulary import EVERY_FAULT
from concord.results.records.trace import read_trace
from concord.runtime.batched.build import without_array_form
from concord.runtime.drivers import DRIVERS, in_memory
from concord.scenarios.bus_table.clusters import cluster_names
from concord.scenarios.catalogue import definitions
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario import RuleChoice, Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.declarations import every_option
from concord.scenarios.types.option import name_of
from concord.scenarios.types.rules import UserRule
from concord.studies.agree import first_difference
from concord.studies.near_agreement import departures
from concord.topology.link_names import EXAMPLES as LINK_EXAMPLES
from concord.topology.names import WEIGHTS, graph_names
from tests.experiments.support import scenario, trace_of

STEPS, NODES = 6, 4
FIRST = "oscillator"
SMALL: dict[str, Any] = {"nodes": NODES, "graph": "ring", "rounds": 1}
SMALLER = {"target-swarm": {"nodes": NODES, "targets": 3, "clutter": 3}}
"""Values for scenarios whose own ones take seconds."""


class Entry(NamedTuple):
    """An entry of a table, the group of its option, and the options that choose it."""

    group: str
    table: str
    name: str
    options: dict[str, Any]


def entries() -> Iterator[Entry]:
    """Yield every entry of every table."""
    for owned in every_option(Scenario):
        declared = owned.declaration
        names: tuple[Any, ...] = (False, True) if declared.annotation is bool else declared.names
        owner = "".join(f"{name}." for _, name in owned.owners)
        for name in names:
            options = {**dict(owned.owners), declared.name: name}
            yield Entry(owned.group, f"{owner}{declared.name}", str(name), options)
    tables: dict[str, tuple[str, tuple[str, ...], dict[str, Any]]] = {
        "arbiter": ("bus", tuple(ARBITERS), {"schedule": "hybrid", "occupancy": 0.5}),
        "cluster": ("bus", cluster_names(), {}),
        "graph": ("network", graph_names(), {}),
        "weights": ("network", WEIGHTS, {}),
        "links": ("faults", tuple(" or ".join(LINK_EXAMPLES.values()).split(" or ")), {}),
    }
    for table, (group, names, beside) in tables.items():
        for name in names:
            yield Entry(group, table, name, {**beside, table: name})
    for named, definition in definitions().items():
        for rule in definition.wirings:
            yield Entry("rule", f"{named}.rule", rule, {"scenario": named, "rule": rule})
    for word, fault in EVERY_FAULT.items():
        changes = [f"2 {fault.example}", *([f"4 {fault.withdrawal}"] if fault.withdrawal else [])]
        yield Entry("faults", "fault", word, {"changes": tuple(changes)})


ENTRIES = list(entries())


def prepared(entry: Entry, folder: Path) -> Setup:
    """Return a network with this entry, on the first plant that allows it.

    Raises:
        ValueError: no plant allows the entry; the message is that of the first one.
    """
    options = dict(entry.options)
    named = options.pop("scenario", None)
    if named is not None:
        small = SMALLER.get(named, {})
        return prepare(scenario(named, **{"steps": STEPS, **small, **options}))
    edges = folder / "path.edges"
    edges.write_text("0 1\n1 2\n2 3\n")
    if "graph" in options:
        options["graph"] = options["graph"].replace("K-", "2-").replace("PATH", str(edges))
    refusals = []
    for name in (FIRST, *definitions()):
        for network in (SMALL, SMALLER.get(name, {})):
            try:
                return prepare(scenario(name, **{"steps": STEPS, **network, **options}))
            except ValueError as refusal:
                refusals.append(refusal)
    raise refusals[0]


Tried = Callable[[int], Setup | str]


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> Tried:
    """The network of an entry by its number, or the sentence that refuses it; prepared once."""
    folder = tmp_path_factory.mktemp("tables")

    @cache
    def network_or_refusal(number: int) -> Setup | str:
        try:
            return prepared(ENTRIES[number], folder)
        except ValueError as refusal:
            return str(refusal)

    return network_or_refusal


IDS = [f"{entry.table} {entry.name}" for entry in ENTRIES]


@pytest.mark.parametrize("number", range(len(ENTRIES)), ids=IDS)
def test_an_entry_runs_in_process_and_batched(number: int, tried: Tried):
    setup = tried(number)
    if isinstance(setup, str):
        assert "\n" not in setup and 20 < len(setup) < 400
        return
    trace = read_trace(setup, in_memory(setup))
    assert np.isfinite(trace.mean).any()
    lacking = without_array_form(setup.scenario)
    assert lacking is None or "\n" not in lacking
    assert not departures(setup, trace)


@pytest.mark.zenoh
@pytest.mark.parametrize("group", dict.fromkeys(entry.group for entry in ENTRIES))
def test_an_entry_of_each_group_gives_equal_bits_over_processes(group: str, tmp_path: Path):
    setup = next(_running(group, tmp_path))
    traces = {}
    for driver, run in DRIVERS.items():
        recording = tmp_path / f"{driver}.mcap"
        run(setup, f"table-{group}", recording, None, lambda _: None)
        traces[driver] = trace_of(setup, recording)
    reference, *others = traces.values()
    assert all(first_difference(reference, other, "processes") is None for other in others)


def _running(group: str, folder: Path) -> Iterator[Setup]:
    """Yield networks with the entries of a group, the last first, without those refused."""
    for entry in reversed(ENTRIES):
        if entry.group == group:
            try:
                yield prepared(entry, folder)
            except ValueError:
                continue


def test_a_rule_is_built_for_every_scenario_or_by_the_wiring_of_some():
    wired = {rule for definition in definitions().values() for rule in definition.wirings}
    for rule in get_args(RuleChoice):
        asked = msgspec.structs.replace(scenario(FIRST), rule=rule())
        if rule.unavailable:
            assert name_of(rule) in wired
            with pytest.raises(ValueError, match=rule.unavailable):
                rule_of(asked)
        elif rule is not UserRule:
            assert rule_of(asked).estimator


def test_most_entries_run(tried: Tried):
    """A table of refusals alone would pass every other test."""
    found = {one: tried(number) for number, one in enumerate(IDS)}
    refused = [f"{one}: {found[one]}" for one in found if isinstance(found[one], str)]
    assert len(refused) < len(ENTRIES) / 5, "\n".join(refused)
