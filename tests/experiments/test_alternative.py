"""The alternative under a verdict: the figures that its own command prints, or nothing."""

import re
from typing import Any

import msgspec
import pytest

from concord.results.figures.summary import Figures, summarise
from concord.results.figures.summary_table import labelled_in_words, opening
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.alternative import labelled_beside

pytestmark = pytest.mark.slow

SMALL: dict[str, Any] = {"nodes": 5, "steps": 45, "graph": "ring", "seed": 3}


def traced(name: str = "target-tracking", **options: Any) -> tuple[Setup, Trace]:
    setup = prepare(definition_named(name).defaults.with_(**{**SMALL, **options}))
    return setup, read_trace(setup, in_memory(setup))


def figures(setup: Setup, trace: Trace) -> Figures:
    found = summarise(setup, trace)
    return msgspec.structs.replace(found, labelled=labelled_beside(setup, trace, found.first_step))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "--rule labelled --schedule dynamic --occupancy 0.25"),
        ({"schedule": "dynamic", "occupancy": 0.4}, "--rule labelled"),
        ({"rule": "hcmci"}, "--rule labelled --schedule dynamic --occupancy 0.25"),
        ({"number": "float16", "schedule": "dynamic", "occupancy": 0.4},
         "--rule labelled (without the options of ci)"),
    ],
)  # fmt: skip
def test_it_is_what_its_own_command_gives(options: dict[str, Any], says: str):
    """Run message by message, as `concord run` does, with the options that the line names."""
    found = figures(*traced(**options))
    assert found.labelled is not None and found.labelled.options == says
    flags = dict(re.findall(r"--(\w+) ([\w.]+)", says))
    kept = {name: options[name] for name in ("schedule", "occupancy") if name in options}
    own = summarise(*traced(**{**kept, **flags, "occupancy": kept.get("occupancy", 0.25)}))
    assert found.labelled.rmse == pytest.approx(own.rmse, rel=1e-9)
    assert own.bus is not None and found.bus is not None
    assert found.labelled.bytes_per_step == own.bus.bytes_per_step
    assert own.rmse_centralised == found.rmse_centralised
    line = opening(found)[1]
    assert f"would give {own.rmse / own.rmse_centralised:.3g} x at " in line
    assert line.startswith(f"on the bus: {found.bus.bytes_per_step:.0f} bytes a step; ")


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
    setup, trace = traced(name, **options)
    found = summarise(setup, trace)
    assert labelled_beside(setup, trace, found.first_step) is None
    assert len(opening(found)) == 1


def test_a_bus_without_time_has_no_bytes():
    found = figures(*traced(bus="ideal"))
    assert found.labelled is not None and found.labelled.bytes_per_step is None
    assert labelled_in_words(found.labelled, found.labelled.rmse, None).startswith(
        "labelled measurements would give 1 x: --rule labelled"
    )
