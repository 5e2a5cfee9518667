"""A bus of the user's own: that of the page, the bus without time again, and broken ones."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from concord.bus.bus import Bus
from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import round_robin
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.panels.timeline import TimelineView
from concord.dashboard.theme import DARK
from concord.results.bus.bus_capture import capture
from concord.results.folder import from_copies, keep_copies
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.definitions.own import portable
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.tempo import tempo_of
from concord.studies.agree import agreement
from concord.studies.monte_carlo.simulate import simulate
from tests.dashboard.runs import frames_of
from tests.pages import ROOT, blocks

PAGE = (ROOT / "docs" / "own_plant.md").read_text(encoding="utf-8")
(SERIAL,) = [code for code in blocks(PAGE, "python") if "class Serial" in code]
# Of the page: bits of a microsecond, and between slots a gap.
GAP_US = 50.0


@pytest.fixture
def serial(tmp_path: Path) -> str:
    file = tmp_path / "serial.py"
    file.write_text(SERIAL)
    return f"{file}:Serial"


def network(bus: Any, **options: Any) -> Scenario:
    return scenario_of("oscillator", nodes=5, steps=12, bus=bus, **options)


def test_the_times_of_the_page_follow_from_its_bit_rate(serial: str):
    setup = prepare(network(serial))
    bus, messages = build_bus(setup), list(in_memory(setup))
    trace = read_trace(setup, messages)
    share = int(trace.payload_bytes.max())
    sending_us = 8 * (share + SHARE_FRAMES.overhead_bytes)
    assert bus.cycle_us == 5 * (sending_us + GAP_US)
    sent = bus.transmissions(0, trace.payload_bytes[0, 0].tolist())
    assert [frame.start_us for frame in sent] == [n * (sending_us + GAP_US) for n in range(5)]
    assert bus.load(sent) == pytest.approx(sending_us / (sending_us + GAP_US))
    assert bus.fusion_delay_us(3, sent) == 3 * bus.cycle_us - GAP_US
    assert tempo_of(setup, 2.0).cycle_s == pytest.approx(2e-6 * bus.cycle_us)
    captured = capture(setup, trace, messages)
    assert captured is not None and len(captured) == 12 * 3 * 5
    with pytest.raises(ValueError, match=r"cycles of .* exceed a step; use --stretch"):
        prepare(network(serial, rounds=200))
    prepare(network(serial, rounds=200, stretch=10))


def test_the_dashboard_draws_it_to_scale(serial: str):
    setup = prepare(network(serial, schedule="hybrid", occupancy=0.4))
    stage = set_stage(setup)
    frame = frames_of(stage, in_memory(setup))[-1]
    cycle = frame.cycles[-1]
    drawn = TimelineView(stage).draw(DARK, frame, [cycle], cycle, 0.0, None)
    boxes = re.findall(r'data-node="(\d+)".*?<rect x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', drawn)
    assert {int(node) for node, *_ in boxes} == {one.node for one in cycle.frames}
    scale = {
        float(width) / (one.end_us - one.start_us)
        for one in cycle.frames
        for node, _, width in boxes
        if int(node) == one.node
    }
    assert max(scale) == pytest.approx(min(scale), rel=0.02)


@pytest.mark.zenoh
@pytest.mark.parametrize("schedule", ["full", "round-robin", "hybrid", "dynamic"])
def test_the_bus_of_the_page_agrees_in_every_driver(serial: str, schedule: str):
    part = {} if schedule == "full" else {"occupancy": 0.4}
    found = agreement(prepare(network(serial, schedule=schedule, **part)))
    assert found.near and found.differences == ()


@pytest.mark.parametrize("schedule", ["full", "round-robin"])
def test_an_own_bus_that_only_repeats_ours_has_its_numbers(schedule: str):
    """Time decides nothing in lockstep: the estimates are those of the bus without time."""
    own, ours = (
        simulate(prepare(network(bus, schedule=schedule)), range(2))
        for bus in (TimelessBus, "ideal")
    )
    np.testing.assert_array_equal(own.mean, ours.mean)
    np.testing.assert_array_equal(own.payload_bytes, ours.payload_bytes)


class Labelled(TimelessBus):
    """Frames under another name."""

    frame_format = SHARE_FRAMES._replace(name="of the user")


def test_a_class_is_found_by_its_file_and_brings_its_own_frames():
    asked = network(Labelled)
    assert portable(asked).bus.name == f"{__file__}:Labelled"
    setup = prepare(asked)
    assert build_bus(setup).frame_format.name == "of the user"
    assert read_trace(setup, in_memory(setup)).steps == 12


def test_a_run_keeps_the_file_and_refuses_another(serial: str, tmp_path: Path):
    setup = prepare(network(serial))
    keep_copies(tmp_path, setup.scenario)
    file = Path(serial.partition(":")[0])
    file.write_text(SERIAL.replace("BIT_US = 1.0", "BIT_US = 2.0"))
    with pytest.raises(ValueError, match="digest"):
        prepare(setup.scenario)
    kept = prepare(from_copies(tmp_path, setup.scenario))
    assert build_bus(kept).cycle_us < build_bus(prepare(network(serial))).cycle_us


def flipped(frame: bytes) -> bytes:
    return bytes([frame[0] ^ 255]) + frame[1:]


def broken(**members: Any) -> type[Bus]:
    return type("Broken", (TimelessBus,), members)


def late(bus: TimelessBus, *asked: Any) -> Any:
    return [frame._replace(end_us=9e9) for frame in own_times(bus, *asked)]


own_times = TimelessBus.transmissions
BROKEN = {
    "its own frame is rejected": broken(
        encode=lambda bus, *asked: [flipped(one) for one in TimelessBus.encode(bus, *asked)]
    ),
    "and payloads tells (1,)": broken(payloads=lambda bus, node, cycle, size: (1,)),
    "due_body does not know the frame": broken(due_body=lambda bus, *asked: None),
    "a frame arrives with cycle 7": broken(
        encode=lambda bus, node, cycle, body: TimelessBus.encode(bus, node, 7, body)
    ),
    "do not join to the body": broken(
        encode=lambda bus, node, cycle, body: TimelessBus.encode(bus, node, cycle, body[::-1])
    ),
    "overlaps that of node 1": broken(
        transmissions=lambda bus, *asked: [
            frame._replace(start_us=0.0, end_us=1.0) for frame in own_times(bus, *asked)
        ]
    ),
    "is not within the cycle of 10 us": broken(has_time=True, cycle_us=10.0, transmissions=late),
    "a cycle must take time": broken(has_time=True),
    "it has frames of nodes []": broken(transmissions=lambda bus, *asked: ()),
    "has no name, schedule": lambda schedule, share_bytes, arbiter: object(),
    "ZeroDivisionError": lambda schedule, share_bytes, arbiter: 1 / 0,
    "its schedule is another one": lambda schedule, share_bytes, arbiter: TimelessBus(
        round_robin(5, 1), share_bytes
    ),
    "must be an attribute of what builds it": lambda *asked: Labelled(*asked),
}


@pytest.mark.parametrize("says", BROKEN)
def test_a_bus_that_breaks_a_promise_is_refused_before_the_start(says: str):
    with pytest.raises(ValueError, match="--bus ") as refused:
        prepare(network(BROKEN[says]))
    assert says in str(refused.value)


def test_a_wrong_bit_that_nobody_notices_is_refused():
    """The frame format promises to find wrong bits, and `receive` does not look."""

    def receive(bus: TimelessBus, frame: bytes) -> Any:
        whole = TimelessBus.encode(bus, 0, 0, bytes(n * 37 % 256 for n in range(28)))
        return TimelessBus.receive(bus, frame if frame in KNOWN else whole[0])

    with pytest.raises(ValueError, match="a wrong bit in byte 0 of a frame is not noticed"):
        prepare(network(broken(receive=receive, encode=remembered)))


KNOWN: set[bytes] = set()


def remembered(bus: TimelessBus, node: int, cycle: int, body: bytes) -> list[bytes]:
    frames = TimelessBus.encode(bus, node, cycle, body)
    KNOWN.update(frames)
    return frames


def test_a_value_that_builds_nothing_is_refused(tmp_path: Path):
    (tmp_path / "mine.py").write_text("BUS = 3")
    with pytest.raises(ValueError, match="it is a int; it must be a function or class build"):
        prepare(network(f"{tmp_path}/mine.py:BUS"))
    with pytest.raises(ValueError, match=r"--relay --bus .*ideal.py:TimelessBus"):
        prepare(network(TimelessBus, rule="labelled", relay=True))
