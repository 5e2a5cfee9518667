"""The cases of `concord compare`: options of scenarios as data, the same for everybody.

A case is a sweep over `rule`. Run r of a case has the same noise under every rule (seed 1), so the
intervals of the comparison are paired.
"""

from typing import NamedTuple

from concord.entries import entries


class Case(NamedTuple):
    """One case of the suite.

    Attributes:
        name: on the command line and in tables.
        purpose: the case in words, and why it is in the suite.
        options: of the scenario, in the words of `concord sweep`.
        runs: Monte-Carlo runs.
        recorded: the case replays recorded data, which `--data` names; it has one run.
    """

    name: str
    purpose: str
    options: dict[str, str]
    runs: int
    recorded: bool = False


_TARGET = {"scenario": "target-tracking", "nodes": "20", "steps": "80", "seed": "1"}


def _tracking(name: str, purpose: str, **options: str) -> Case:
    """A target on the full bus, or on a part; on a tenth a lost node makes the errors spread."""
    part = {} if "occupancy" in options else {"schedule": "full"}
    runs = 200 if options.get("occupancy") == "0.1" else 60
    return Case(name, purpose, {**_TARGET, **part, **options}, runs)


_CASES = (
    _tracking(
        "geometric",
        "20 sensors with a limited field of view on a geometric graph, full bus: the usual case",
        graph="geometric",
    ),
    _tracking(
        "geometric-25",
        "the same with a quarter of the nodes on the bus in a cycle",
        graph="geometric",
        occupancy="0.25",
    ),
    _tracking(
        "geometric-10",
        "the same with a tenth of the nodes on the bus in a cycle",
        graph="geometric",
        occupancy="0.1",
    ),
    _tracking(
        "path",
        "the same sensors on a path: information needs 19 hops",
        graph="path",
    ),
    _tracking("path-25", "the path with a quarter of the bus", graph="path", occupancy="0.25"),
    _tracking("path-10", "the path with a tenth of the bus", graph="path", occupancy="0.1"),
    _tracking(
        "small-world",
        "the same sensors on a small-world graph: short paths, 4 neighbours",
        graph="small-world",
    ),
    _tracking(
        "small-25",
        "the small world with a quarter of the bus",
        graph="small-world",
        occupancy="0.25",
    ),
    _tracking(
        "small-10",
        "the small world with a tenth of the bus",
        graph="small-world",
        occupancy="0.1",
    ),
    _tracking(
        "loss",
        "the geometric graph, full bus, and links that lose 30 % of the frames",
        graph="geometric",
        loss="0.3",
    ),
    _tracking(
        "kill",
        "the geometric graph, full bus; node 4 ends at step 40",
        graph="geometric",
        changes="40 kill 4",
    ),
)


def suite() -> tuple[Case, ...]:
    """Return all cases: those of the core, then those of entries."""
    return (*_CASES, *(_case(name, *entry[:2]) for name, entry in entries("CASES").items()))


def _case(name: str, words: str, purpose: str) -> Case:
    """A case of an entry: `scenario=... runs=... recorded=yes`, as in `KINDS`."""
    options = dict(word.split("=", 1) for word in words.split())
    runs, recorded = int(options.pop("runs")), options.pop("recorded", "no") == "yes"
    return Case(name, purpose, options, runs, recorded)
