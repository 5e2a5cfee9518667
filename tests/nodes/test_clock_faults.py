"""The fault word `drift`: corrected clocks, halted nodes, and a bus that keeps no clocks."""

import numpy as np
import pytest

from concord.bus.clocks import ClockDrift
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.scenarios import equipment
from concord.scenarios.build import build_bus
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
    sends = [bus.clock_errors(4, drifts, cycle).sends[node] for cycle in range(30)]
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
