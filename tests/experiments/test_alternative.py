"""The alternative beside a run: it is better, and its command gives what the line says."""

import json
import shlex
from typing import Any

import pytest

from concord.results.figures.summary import Summary, summarise
from concord.results.records.runs import Runs, runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.studies.alternative import labelled_beside
from tests.experiments.command_support import concord

pytestmark = pytest.mark.slow

SMALL: dict[str, Any] = {"nodes": 5, "steps": 45, "graph": "ring", "seed": 4}


def traced(name: str = "target-tracking", **options: Any) -> tuple[Runs, Summary]:
    setup = prepare(definition_named(name).defaults.with_(**{**SMALL, **options}))
    runs = runs_of_trace(setup, read_trace(setup, in_memory(setup)))
    return runs, summarise(runs)


@pytest.mark.parametrize(
    "options",
    [
        {"schedule": "dynamic", "occupancy": 0.4},
        {"number": "float16", "schedule": "dynamic", "occupancy": 0.4},
        {"bus": "ideal"},
    ],
)
def test_its_command_gives_what_the_line_says(options: dict[str, Any], tmp_path, capsys):
    runs, own = traced(**options)
    found = labelled_beside(runs, own)
    assert found is not None and found.to_centralised < own.value("to_centralised")
    words = shlex.split(found.command)[1:]
    said = json.loads(concord(capsys, *words, "--json", "--out", tmp_path / "run").out)
    assert said["to_centralised"][0] == pytest.approx(found.to_centralised, rel=1e-9)
    assert said["rmse_centralised"][0] == pytest.approx(own.value("rmse_centralised"), rel=1e-9)
    if options.get("bus") == "ideal":
        assert found.bytes_per_step is None
    else:
        assert said["bytes_per_step"][0] == found.bytes_per_step


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("target-tracking", {"rule": "labelled"}),
        ("target-tracking", {"steps": 30}),  # ten steps are scored
        ("target-tracking", {"changes": ("20 kill 1",)}),
        ("target-tracking", {"graph": "edges:0>1;1>2;2>3;3>4;4>0", "weights": "equal-neighbour"}),
        ("dc-motor-position", {"control": "0"}),
        ("liu2021-network", {"rule": "ellipsoid", "nodes": 6}),
    ],
)
def test_nothing_is_said_where_it_could_not_be_compared(name: str, options: dict[str, Any]):
    assert labelled_beside(*traced(name, **options)) is None


def test_nothing_is_said_where_the_rule_is_as_good():
    """All nodes that hear all of each other have what `labelled` would give them."""
    runs, own = traced("oscillator", steps=60, graph="complete", rule="hcmci")
    found = labelled_beside(runs, own)
    assert found is None or found.to_centralised < own.value("to_centralised")
