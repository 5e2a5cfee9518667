"""Every driver gives the same bits: one process, or one per node over zenoh.

The test compares recorded data: truth, readings, publishers, estimates, ages.
"""

from pathlib import Path

import numpy as np
import pytest

from concord.results.records.trace import Trace
from concord.runtime.drivers import DRIVERS
from concord.runtime.network.links import wants_router
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.agree import DriverDifference, first_difference
from tests.experiments.command_support import concord
from tests.experiments.support import scenario, small, trace_of
from tests.nodes.test_faults import SWARM

pytestmark = pytest.mark.slow

# fmt: off
SMALL = {
    "oscillator on a ring": {"graph": "ring"},
    "one node": {"nodes": 1, "graph": "complete"},
    "two nodes, one round": {"nodes": 2, "graph": "path", "rounds": 1},
    "through a router": {"nodes": 11, "graph": "complete", "steps": 4},
    "in turns": {"schedule": "round-robin", "occupancy": 0.25, "nodes": 5, "graph": "star"},
    "with a dynamic segment": {"schedule": "hybrid", "occupancy": 0.5, "nodes": 6},
    "contention alone": {"schedule": "dynamic", "occupancy": 0.5, "nodes": 5, "graph": "path"},
    "float32 on the wire": {"number": "float32", "graph": "path"},
    "two bytes a number": {"number": "float16", "graph": "path"},
    "two bytes a number, prior and novelty": {"number": "float16", "rule": "hcmci", "loss": 0.3},
    "the papers' average": {"rule": "wac", "hold": "drop"},
    "more rounds than a cycle counter": {"rounds": 70, "steps": 2, "graph": "path"},
    "links that lose frames": {"loss": 0.3},
    "links that lose frames, in turns and contention": {
        "loss": 0.4,
        "schedule": "hybrid",
        "occupancy": 0.5,
        "nodes": 6,
        "rule": "hcmci",
    },
    "links that lose parts of shares": {"loss": 0.2, "cluster": "audi", "graph": "path"},
    "links that fail and come back": {"links": "markov:0.2,0.4", "graph": "star"},
    "graphs that take turns": {"links": "switching:ring,path:2", "loss": 0.1},
    "nodes that leave and come back, links and settings that change": {
        "nodes": 6,
        "steps": 24,
        "changes": (
            "3 kill 3",
            "5 cut 1 2",
            "7 loss 0.3",
            "8 restart 3",
            "9 heal 1 2",
            "10 kill 0",
            "10 kill 5",
            "12 set rule=hcmci rounds=2 occupancy=0.5",
            "14 restart 5",
            "16 restart 0",
            "18 set rule=labelled rounds=4",
            "20 kill 2",
        ),
    },
    "every kind of fault at once": {
        "steps": 17,
        "changes": SWARM,
    },
    "faults in contention, in several frames": {
        "nodes": 6,
        "cluster": "audi",
        "schedule": "hybrid",
        "occupancy": 0.5,
        "changes": (
            "1 corrupt 0.2", "1 reorder 0.5", "2 hang 5 3", "2 missing 4 0.5", "3 jitter 2",
            "3 duplicate 0.5", "4 spoof 0 5 1", "5 replay 1 0.5 3", "6 calm",
        ),
    },
    "clocks that drift, two that halt, and one that is mended": {
        "nodes": 6,
        "steps": 20,
        "rounds": 2,
        "schedule": "hybrid",
        "occupancy": 0.5,
        "changes": ("1 drift 2 1500", "2 drift 0 9000", "2 drift 5 -9000", "14 drift 0 0"),
    },
    "shares that are cut": {
        "nodes": 8,
        "cluster": "flexray-adapter",
        "schedule": "dynamic",
        "urgency_classes": 2,
        "withdrawal": False,
        "loss": 0.1,
        "changes": ("2 missing 1 0.5", "3 corrupt 0.2", "4 kill 2", "6 restart 2"),
    },
    "another run of the same seed": {"seed": 9, "run": 3},
}
# fmt: on
TRACKING = {
    "target-tracking": {"nodes": 6, "graph": "geometric", "steps": 6, "seed": 7},
    "target-crossing": {"nodes": 5, "graph": "path", "steps": 6},
}


def assert_agreement(setup: Setup, folder: Path) -> Trace:
    """Return the trace of the run in process; those of the other drivers have the same bits."""
    found = {}
    for name, driver in DRIVERS.items():
        recording = folder / f"{name}.mcap"
        driver(setup, f"agree-{name}", recording, None, lambda step: None)
        found[name] = trace_of(setup, recording)
    reference = found["in-process"]
    assert reference.steps == setup.scenario.steps
    for name, trace in found.items():
        assert first_difference(reference, trace, name) is None
        assert trace.counters == reference.counters
    return reference


@pytest.mark.zenoh
@pytest.mark.parametrize("name", SMALL)
def test_drivers_agree_on_the_oscillator(name: str, tmp_path: Path):
    setup = small(**{"steps": 8, **SMALL[name]})
    assert wants_router(setup.neighbours) == (name == "through a router")
    trace = assert_agreement(setup, tmp_path)
    assert trace.published.any()


@pytest.mark.zenoh
def test_drivers_agree_where_some_hear_and_are_not_heard(tmp_path: Path):
    """Return a ring on which each node hears only the next: entry (i, j) says that i hears j."""
    file = tmp_path / "ring.csv"
    file.write_text("0,1,0,0\n0,0,1,0\n0,0,0,1\n1,0,0,0\n")
    setup = small(graph=f"directed:{file}", weights="equal-neighbour", steps=8)
    assert setup.neighbours == [[1], [2], [3], [0]]
    assert_agreement(setup, tmp_path)


@pytest.mark.zenoh
@pytest.mark.parametrize("name", TRACKING)
def test_drivers_agree_on_targets(name: str, tmp_path: Path):
    assert_agreement(prepare(scenario(name, **TRACKING[name])), tmp_path)


@pytest.mark.zenoh
@pytest.mark.parametrize("graph", ["complete", "path"])
def test_drivers_agree_on_recorded_robots(graph: str, mrclam_folder: Path, tmp_path: Path):
    asked = scenario("mrclam", data=str(mrclam_folder), target=4, steps=60, graph=graph)
    assert_agreement(prepare(asked), tmp_path)


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.parametrize(
    ("nodes", "graph", "steps"), [(12, "geometric", 40), (32, "4-regular", 10)]
)
def test_drivers_agree_on_larger_networks(nodes: int, graph: str, steps: int, tmp_path: Path):
    asked = scenario("target-tracking", nodes=nodes, graph=graph, steps=steps, seed=7)
    assert_agreement(prepare(asked), tmp_path)


# --- the comparison itself -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    setup, file = small(steps=5), tmp_path_factory.mktemp("reference") / "run.mcap"
    DRIVERS["in-process"](setup, "reference", file, None, lambda step: None)
    return trace_of(setup, file)


def changed(trace: Trace, quantity: str, index: tuple[int, ...], value: float) -> Trace:
    array = getattr(trace, quantity).copy()
    array[index] = value
    return trace._replace(**{quantity: array})


def test_one_bit_is_a_difference(reference: Trace):
    for quantity in ("truth", "mean", "cov"):
        index = (3,) + (0,) * (getattr(reference, quantity).ndim - 1)
        value = np.nextafter(getattr(reference, quantity)[index], np.inf)
        difference = first_difference(reference, changed(reference, quantity, index, value), "x")
        assert difference == DriverDifference(
            "x", quantity, list(index), float(getattr(reference, quantity)[index]), float(value)
        )


def test_the_earliest_step_is_named(reference: Trace):
    late = changed(reference, "truth", (4, 0), 7.0)
    both = changed(late, "mean", (2, 1, 0), 7.0)
    difference = first_difference(reference, both, "x")
    assert difference is not None
    assert (difference.quantity, difference.index) == ("mean", [2, 1, 0])


def test_bits_are_compared_and_not_values(reference: Trace):
    zero = changed(reference, "mean", (0, 0, 0), 0.0)
    assert first_difference(zero, changed(zero, "mean", (0, 0, 0), -0.0), "x") is not None
    missing = changed(reference, "mean", (0, 0, 0), np.nan)
    assert first_difference(missing, missing, "x") is None


def test_who_published_and_what_is_held_are_compared(reference: Trace):
    silent = reference._replace(payload_bytes=np.zeros_like(reference.payload_bytes))
    assert getattr(first_difference(reference, silent, "x"), "quantity", None) == "published"
    older = reference._replace(ages=reference.ages + 1)
    assert getattr(first_difference(reference, older, "x"), "quantity", None) == "ages"


def test_a_shorter_run_is_a_difference(reference: Trace):
    shorter = reference._replace(truth=reference.truth[:-1])
    assert getattr(first_difference(reference, shorter, "x"), "quantity", None) == "truth shape"


# --- the command ---------------------------------------------------------------------------------


@pytest.mark.zenoh
def test_the_command_says_equal_and_leaves_with_zero(capsys: pytest.CaptureFixture[str]):
    options = ["--scenario", "oscillator", "--nodes", "3", "--graph", "path", "--steps", "5"]
    said = concord(capsys, "agree", *options)
    assert said.code == 0 and "in-process = processes, bit for bit" in said.out


@pytest.mark.parametrize("as_json", [True, False])
def test_the_command_names_the_first_difference_and_leaves_with_one(
    as_json: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """A second driver that runs another seed."""

    def other(setup: Setup, *rest):
        changed = setup.scenario.with_(seed=2)
        return DRIVERS["in-process"](prepare(changed), *rest)

    monkeypatch.setattr(
        "concord.studies.agree.DRIVERS",
        {"in-process": DRIVERS["in-process"], "other": other},
    )
    options = ["--scenario", "oscillator", "--nodes", "3", "--graph", "path", "--steps", "5"]
    captured = concord(capsys, "agree", *options, *(["--json"] if as_json else []))
    assert captured.code == 1
    if as_json:
        said = captured.json()
        assert said["drivers"] == ["in-process", "other", "batched"]
        assert said["differences"][0]["index"][0] == 0
    else:
        assert "other differs from in-process first in" in captured.out
        assert "bit for bit" not in captured.out
