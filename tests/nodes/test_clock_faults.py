"""The fault word `drift`: corrected clocks, halted nodes, and a bus that keeps no clocks."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.bus.clocks import ClockDrift
from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.flexray.presets import DEMO
from concord.nodes.changes import Gone, Loss
from concord.nodes.messages import Measured
from concord.nodes.node import initial_state, step
from concord.nodes.node_changes import apply
from concord.nodes.node_state import Phase
from concord.scenarios import equipment
from concord.scenarios.build import build_bus, build_node
from tests.nodes.changing import run, same_bits
from tests.nodes.fault_networks import FIRST, ROUNDS, STEPS, from_first, ring, total

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("ppm", [600.0, -1300.0])
def test_an_uncorrected_clock_is_refused_once_it_is_beyond_the_precision(
    ppm: float, monkeypatch: pytest.MonkeyPatch
):
    # No bus keeps its clocks together.
    monkeypatch.setattr(equipment, "KeepsClocks", type(None))
    setup = ring()
    bus = build_bus(setup)
    assert isinstance(bus, FlexRayBus)
    cluster = bus.cluster
    off_us, refused = 0.0, 0
    for _ in range((STEPS - FIRST) * ROUNDS):
        off_us += ppm * 1e-6 * cluster.cycle_us
        refused += abs(off_us) > cluster.action_point_us
    assert 0 < refused < (STEPS - FIRST) * ROUNDS
    drifting = run(setup, *from_first(f"drift 2 {ppm:g}"))
    # Two neighbours refuse it, and it refuses two.
    assert total(drifting)["rejected slot-boundary"] == 4 * refused


@pytest.mark.parametrize("ppm", [20, -100, 1500, -2900])
@pytest.mark.parametrize("node", [2, 5])
def test_clock_correction_bears_what_an_oscillator_may_deviate(node: int, ppm: int):
    """Node 5 of a hybrid network sends no sync frames; node 2 does."""
    setup = ring(nodes=6, schedule="hybrid", occupancy=0.5, steps=30)
    plain, drifting = run(setup), run(setup, *from_first(f"drift {node} {ppm}"))
    assert same_bits(drifting, plain)
    assert total(drifting) == total(plain)


@pytest.mark.parametrize("ppm", [100, 1500])
def test_an_ordinary_crystal_costs_no_frame_on_a_cars_bus(ppm: int):
    """67 cycles bring the clock to 1500 ppm there."""
    setup = ring(cluster="audi", steps=30)
    plain, drifting = run(setup), run(setup, f"1 drift 2 {ppm}")
    assert same_bits(drifting, plain)
    assert total(drifting) == total(plain)


@pytest.mark.parametrize("ppm", [4000, -9000])
@pytest.mark.parametrize("node", [0, 2])
def test_a_clock_beyond_its_rate_correction_halts_its_node(node: int, ppm: int):
    setup = ring(rounds=1, steps=30)
    drifting = run(setup, *from_first(f"drift {node} {ppm}"))
    assert "rejected slot-boundary" not in total(drifting)
    bus = build_bus(setup)
    assert isinstance(bus, FlexRayBus)
    drifts = (ClockDrift(node, ppm, FIRST),)
    sends = [bus.clock_errors(4, drifts, (), cycle, (0, 0)).sends[node] for cycle in range(30)]
    silent = drifting.counters[node]["silent"]
    halted = 30 - silent
    assert FIRST < halted < 20
    assert sends == [cycle < halted for cycle in range(30)]
    # The node that is halted is a node that is cut off, but that its slots stay empty.
    ends = [f"{halted} cut {node} {(node + side) % 4}" for side in (1, 3)]
    cut = run(setup, *ends)
    assert same_bits(drifting, cut)
    # Nothing but the silent node's own reception is lost.
    assert total(drifting)["lost"] == 2 * silent == total(cut)["lost"] / 2


def test_a_halted_contender_asks_for_no_slot():
    setup = ring(nodes=6, schedule="hybrid", occupancy=0.5, steps=30)
    plain = run(setup)
    drifting = run(setup, *from_first("drift 5 9000"))
    halted = int(np.flatnonzero(drifting.asked[:, :, 5].any(axis=1))[-1]) + 1
    assert FIRST < halted < 20
    assert plain.asked[halted:, :, 5].any()
    assert not drifting.published[halted:, :, 5].any()


def test_clocks_that_drift_together_understand_each_other():
    setup = ring()
    together = run(setup, *(f"0 drift {node} 1500" for node in range(4)))
    assert same_bits(together, run(setup))
    assert "rejected slot-boundary" not in total(together)


@pytest.fixture
def two_sync_nodes(tmp_path: Path) -> str:
    """A cluster in which nodes 0 and 1 of a network send the sync frames."""
    cluster = msgspec.structs.replace(DEMO, sync_slots=(1, 2), startup_slots=(1, 2))
    path = tmp_path / "two.toml"
    path.write_text(cluster_to_toml(cluster))
    return str(path)


@pytest.mark.parametrize(
    "words",
    [
        ("kill 0", "kill 1"), ("hang 0 100", "hang 1 100"), ("missing 0 1", "missing 1 1"),
        ("crc 0 1", "kill 1"),
    ],
)  # fmt: skip
def test_a_cluster_without_its_sync_nodes_stops(two_sync_nodes: str, words: tuple[str, ...]):
    setup = ring(nodes=6, graph="complete", cluster=two_sync_nodes, steps=8)
    struck = run(setup, *from_first(*words))
    # Between two steps many more cycles pass than a controller bears without corrections.
    speaks = struck.published[:, :, 2:].any(axis=(1, 2))
    assert speaks.tolist() == [step <= FIRST for step in range(8)]
    silent = [one.get("silent", 0) for one in struck.counters[2:]]
    assert silent == [(8 - FIRST - 1) * ROUNDS] * 4


@pytest.mark.parametrize(
    "words",
    [
        ("kill 0",), ("missing 0 1",), ("missing 0 0.9", "missing 1 0.9"), ("null 0 1", "null 1 1"),
    ],
)  # fmt: skip
def test_sync_frames_that_are_left_keep_the_other_nodes(
    two_sync_nodes: str, words: tuple[str, ...]
):
    """Node 0 alone leaves node 1 without a sync frame of another node; a null frame is one."""
    setup = ring(nodes=6, graph="complete", cluster=two_sync_nodes, steps=5)
    struck = run(setup, *from_first(*words))
    stops = words in (("kill 0",), ("missing 0 1",))
    silent = [one.get("silent", 0) for one in struck.counters[2:]]
    assert any(silent) == stops


def test_a_sync_node_that_returns_brings_the_network_back(two_sync_nodes: str):
    setup = ring(nodes=6, graph="complete", cluster=two_sync_nodes, steps=10)
    ends = ("3 kill 0", "3 kill 1", "6 restart 0", "6 restart 1")
    struck = run(setup, *ends)
    speaks = struck.published[:, :, 2:].any(axis=(1, 2)).tolist()
    assert speaks == [step <= 3 or step >= 6 for step in range(10)]


def test_turns_of_nodes_have_no_key_slots():
    """Other controllers then send the sync frames, and no fault of a node takes them."""
    setup = ring(nodes=6, schedule="round-robin", occupancy=0.5)
    bus = build_bus(setup)
    assert isinstance(bus, FlexRayBus)
    assert bus.sync_nodes == ()
    struck = run(setup, *from_first(*(f"missing {node} 1" for node in range(5))))
    assert "silent" not in struck.counters[5]


def test_a_neighbour_whose_process_ends_takes_its_sync_frames(two_sync_nodes: str):
    """All nodes apply the end in the step whose heartbeat tells of it, whenever it came."""
    setup = ring(nodes=3, cluster=two_sync_nodes)
    config = build_node(setup, 2)
    heard, _ = step(config, initial_state(config), Gone(0))
    found = []
    for state in (heard, initial_state(config)):
        for changes in ((Loss(0.5),), (Loss(0.5), Gone(0, 0))):
            changed, _ = step(config, state, Measured(2, 0, [[None]], None, changes))
            assert changed.phase is Phase.CHANGE
            after, changed, _ = apply(config, changed)
            found.append((after.standing.out_since, sorted(changed.absent)))
    assert found == [((), [0]), (((0, 0),), [0]), ((), []), (((0, 0),), [0])]
    config = after
    assert [outage.node for outage in config.faults.outages] == [0]
