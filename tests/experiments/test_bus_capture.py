"""Test the bus data of a run: the capture, the arrays, and Wireshark's decoding of them."""

import struct
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray

from concord.bus.bus import Captured
from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.flexray.frame import decode as decode_frame
from concord.bus.flexray.presets import AUDI, DEMO
from concord.bus.flexray.share_frames import read_frame
from concord.bus.pcap import packet
from concord.results.bus.bus_capture import capture, traffic_of
from concord.results.bus.bus_report import figures_of
from concord.results.bus.node_capture import node_capture
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.recording import read_recording
from concord.scenarios.build import build_bus
from concord.scenarios.setup import Setup
from tests.experiments.bus_runs import run
from tests.experiments.command_support import concord, dissect, needs_tshark, refused

# --- what a run leaves -------------------------------------------------------------------------


def packets(path: Path) -> list[tuple[int, bytes]]:
    """(time in ns, packet) of a capture file."""
    data = path.read_bytes()
    found, at = [], 24
    while at < len(data):
        seconds, nanoseconds, size, _ = struct.unpack_from("<IIII", data, at)
        found.append((seconds * 1_000_000_000 + nanoseconds, data[at + 16 : at + 16 + size]))
        at += 16 + size
    return found


@pytest.fixture
def tracking(tmp_path: Path, capsys) -> Path:
    """A run of the tracking scenario on the car's cluster, half static and half dynamic."""
    folder = tmp_path / "run"
    said = concord(
        capsys, "run", "--scenario", "target-tracking", "--nodes", 20, "--occupancy", 0.25,
        "--schedule", "hybrid", "--number", "float64", "--cluster", "audi", "--steps", 4,
        "--out", folder, "--json",
    )  # fmt: skip
    figures = said.json()["bus"]
    assert figures["cluster"] == "audi" and figures["contenders"] == 10
    return folder


def on_the_bus(cycle: int) -> int:
    """Number on the bus of the cycle that nodes count, with turns of four: a step of 1 s begins in
    cycle 200, 400, ... and waits until its turn is due."""
    step, number = divmod(cycle, 3)
    return next(b for b in range(200 * step, 200 * step + 4) if b % 4 == 3 * step % 4) + number


def recorded_shares(folder: Path) -> list[bytes]:
    messages = read_recording(folder / "run.mcap")
    return [data for topic, data in messages if topic.startswith("share/")]


def test_the_capture_has_every_recorded_frame_in_the_order_of_the_bus(tracking: Path):
    frames = [(read_frame(data), data) for data in recorded_shares(tracking)]
    # Slots are numbered in order of time, so cycle and frame ID say the order of the bus.
    frames.sort(key=lambda frame: (frame[0].cycle, frame[0].frame_id))
    found = packets(tracking / "bus.pcap")
    assert [packet[2:] for _, packet in found] == [data[:-3] for _, data in frames]
    times_ns = np.array([time_ns for time_ns, _ in found])
    assert (np.diff(times_ns) > 0).all()
    for (fragment, _), time_ns in zip(frames, times_ns, strict=True):
        in_cycle_us = time_ns / 1e3 - on_the_bus(fragment.cycle) * AUDI.cycle_us
        assert 0 < in_cycle_us < AUDI.cycle_us
        # The counter in the header is the time on the bus.
        assert fragment.count == time_ns // round(1e3 * AUDI.cycle_us) % 64
        if fragment.frame_id <= AUDI.static_slots:
            slot_us = AUDI.slot_start_us(fragment.frame_id) + AUDI.action_point_us
            assert in_cycle_us == pytest.approx(slot_us, abs=0.01)


@needs_tshark
def test_wireshark_opens_the_capture_of_a_run(tracking: Path):
    rows = dissect(
        tracking / "bus.pcap", "flexray.fid", "flexray.cc", "flexray.eff", "_ws.malformed",
        "_ws.expert",
    )  # fmt: skip
    sent = sorted(
        (fragment.cycle, fragment.frame_id)
        for fragment in map(read_frame, recorded_shares(tracking))
    )
    assert [(int(row[1]), int(row[0])) for row in rows] == [
        (on_the_bus(c) % 64, i) for c, i in sent
    ]
    assert all(int(row[2], 16) == 0 and row[3:] == ["", ""] for row in rows)


def test_the_arrays_tell_the_times_of_the_bus(tracking: Path):
    data = xarray.load_dataset(tracking / "run.nc").isel(run=0)
    assert data["bus_load"].dims == ("step", "round") and data["bus_load"].shape == (4, 3)
    assert data["delay_us"].dims == ("step",) and data["delay_us"].attrs["units"] == "us"
    start, end = data["share_start_us"], data["share_end_us"]
    assert start.dims == end.dims == data["payload_bytes"].dims
    np.testing.assert_array_equal(np.isfinite(start), data["payload_bytes"] > 0)
    span = (end - start).where(data["payload_bytes"] > 0)
    # In the static segment a share of 160 bytes takes seven slots, in the dynamic one frame.
    seven_us = 6 * AUDI.static_slot_us + AUDI.frame_us(34)
    for nodes, length_us in ((slice(0, 10), seven_us), (slice(10, 20), AUDI.frame_us(168))):
        found = span[..., nodes].values
        np.testing.assert_allclose(found[np.isfinite(found)], length_us)
    cycles = np.array([on_the_bus(cycle) for cycle in range(12)]).reshape(4, 3)
    np.testing.assert_array_equal(data["bus_cycle"], cycles)
    waited_us = AUDI.cycle_us * cycles[:, 2] - 1e6 * data["time"]
    np.testing.assert_allclose(data["delay_us"], waited_us + end[:, 2].max("node"))
    assert not np.logical_and(data["asked"] == 1, data["payload_bytes"].node < 10).any()


def test_a_stretched_step_moves_the_capture(tmp_path: Path, capsys):
    folder = tmp_path / "run"
    concord(
        capsys, "run", "--scenario", "oscillator", "--nodes", 4, "--graph", "ring", "--steps", 3,
        "--cluster", "demo", "--stretch", 2.5, "--out", folder,
    )  # fmt: skip
    found = packets(folder / "bus.pcap")
    assert len(found) == 3 * 3 * 4
    # Steps of 100 ms become 250 ms; cycles and slots stay as they are.
    first_ns = [found[12 * step][0] for step in range(3)]
    assert np.diff(first_ns) == pytest.approx(250e6, abs=1)
    assert found[4][0] - found[0][0] == pytest.approx(DEMO.cycle_us * 1e3, abs=1)


def test_two_channels_carry_every_frame_with_their_own_checksum(tmp_path: Path):
    path = tmp_path / "both.toml"
    path.write_text(cluster_to_toml(msgspec.structs.replace(DEMO, channels="AB")))
    both = run(cluster=str(path), occupancy=0.5)
    captured = capture(both.setup, both.trace, both.messages)
    assert captured is not None
    assert [one.channel for one in captured] == ["A", "B"] * (len(captured) // 2)
    for on_a, on_b in zip(captured[::2], captured[1::2], strict=True):
        assert on_a.time_us == on_b.time_us
        assert on_a.data[:-3] == on_b.data[:-3] and on_a.data[-3:] != on_b.data[-3:]
    figures = figures_of(runs_of_trace(both.setup, both.trace))
    single = run(cluster="demo", occupancy=0.5)
    alone = figures_of(runs_of_trace(single.setup, single.trace))
    assert figures is not None and alone is not None
    assert figures.bus_load == pytest.approx(alone.bus_load)


def test_a_torn_recording_gives_the_frames_that_are_left():
    whole = run(cluster="audi", nodes=4, occupancy=0.5)
    before = capture(whole.setup, whole.trace, whole.messages)
    shares = [i for i, (topic, _) in enumerate(whole.messages) if topic.startswith("share/")]
    torn = [message for i, message in enumerate(whole.messages) if i not in shares[::3]]
    after = capture(whole.setup, read_trace(whole.setup, torn), torn)
    assert before is not None and after is not None
    assert len(before) == len(shares)
    assert 0 < len(after) <= len(torn)
    assert {one.data for one in after} <= {one.data for one in before}


def test_a_run_without_bus_time_leaves_no_capture(tmp_path: Path, capsys):
    folder = tmp_path / "run"
    said = concord(
        capsys, "run", "--scenario", "oscillator", "--nodes", 3, "--steps", 2, "--bus", "ideal",
        "--out", folder, "--json",
    )  # fmt: skip
    assert "bus" not in said.json()
    assert not (folder / "bus.pcap").exists()
    assert "bus_load" not in xarray.load_dataset(folder / "run.nc")


def test_the_counter_goes_on_with_time_where_the_settings_change():
    """Steps of 100 ms on cycles of 5 ms: turns of five with one share of five, then no turns."""
    changes = ("4 set rounds=2", "4 set occupancy=1")
    changed = run(
        cluster="audi", schedule="round-robin", occupancy=0.2, steps=8, rounds=3, changes=changes
    )
    shares = [data for topic, data in changed.messages if topic.startswith("share/")]
    counts: dict[int, set[int | None]] = {}
    for data in shares:
        fragment = read_frame(data)
        counts.setdefault(fragment.cycle, set()).add(fragment.count)
    expected = {}
    for step in range(8):
        first, rounds = (3 * step, 3) if step < 4 else (12 + 2 * (step - 4), 2)
        turn = (b for b in range(20 * step, 20 * step + 5) if b % 5 == first % 5 or step >= 4)
        begins = next(turn)
        expected |= {first + number: {(begins + number) % 64} for number in range(rounds)}
    assert counts == expected
    rejected = [name for one in changed.trace.counters for name in one if "reject" in name]
    assert not rejected


# --- faults on the wire --------------------------------------------------------------------------


def flags(one: Captured) -> int:
    """The byte of error flags in a frame's packet."""
    return packet(one)[17]


def test_the_capture_counts_what_the_nodes_counted():
    """Each frame of a ring has two listeners, who count what the wire shows once."""
    changes = ("2 crc 1 0.5", "2 null 2 0.5", "2 missing 3 0.5", "3 babble 4 0.2", "5 calm")
    struck = run(steps=8, changes=changes)
    plain = run(steps=8)
    captured = capture(struck.setup, struck.trace, struck.messages)
    whole = capture(plain.setup, plain.trace, plain.messages)
    assert captured is not None and whole is not None
    counted = sum((Counter(one) for one in struck.trace.counters), Counter())
    collided = [one for one in captured if flags(one) & 0x02]
    alone = [one for one in captured if not flags(one) & 0x02]
    wrong = [one for one in alone if flags(one) & 0x10]
    null = [one for one in alone if not flags(one) and decode_frame(one.data).null]
    assert min(map(len, (collided, wrong, null))) > 0
    assert 2 * len(collided) == counted["rejected collision"]
    assert 2 * len(wrong) == counted["rejected frame-crc"]
    assert 2 * len(null) == counted["rejected null-frame"]
    # The node is silent in whole cycles, in which the capture has gaps.
    frames_per_share = len(whole) // (5 * 3 * 8)
    assert len(whole) - len(captured) == counted["silent"] * frames_per_share > 0
    # Before the first change and after the last one the wire is as it was without.
    step_us = struck.setup.time_step_s * 1e6
    for first, last in ((0, 2), (5, 8)):
        part = [flags(one) for one in captured if first <= one.time_us / step_us < last]
        assert part == [0] * (len(whole) // 8 * (last - first))


def test_a_channel_that_fails_is_empty_and_the_other_is_not():
    struck = run(steps=6, cluster="fitted-ab", changes=("2 channel A 1", "2 crc 1 1"))
    captured = capture(struck.setup, struck.trace, struck.messages)
    assert captured is not None
    step_us = struck.setup.time_step_s * 1e6
    on_a = [one for one in captured if one.channel == "A"]
    on_b = [one for one in captured if one.channel == "B"]
    assert len(on_b) == 3 * len(on_a)
    assert all(one.time_us < 2 * step_us for one in on_a)
    # A broken checksum is broken on the channel that is left; others are right there.
    wrong = [one for one in on_b if flags(one)]
    assert {flags(one) for one in wrong} == {0x10}
    assert 5 * len(wrong) == len([one for one in on_b if one.time_us >= 2 * step_us])


# --- key slots, null frames and captures of nodes ------------------------------------------------


def test_key_slots_carry_sync_frames_and_three_of_them_start_the_cluster():
    full = run(nodes=17, cluster="audi", steps=2, number="float32")
    captured = capture(full.setup, full.trace, full.messages)
    assert captured is not None
    # A share takes two slots; node i owns slots 2 i + 1 and 2 i + 2 in every cycle.
    seen = {
        (frame.frame_id, frame.sync, frame.startup)
        for frame in (decode_frame(one.data) for one in captured)
    }
    shares = len({decode_frame(one.data).frame_id for one in captured}) // 17
    for frame_id, sync, startup in seen:
        node, part = divmod(frame_id - 1, shares)
        assert (sync, startup) == (part == 0 and node < 15, part == 0 and node < 3)
    assert len(seen) == 17 * shares


@pytest.mark.parametrize("schedule", ["round-robin", "dynamic"])
def test_slots_that_nodes_share_are_no_key_slots(schedule: str):
    turns = run(cluster="audi", schedule=schedule, occupancy=0.4)
    captured = capture(turns.setup, turns.trace, turns.messages)
    assert captured
    assert not any(decode_frame(one.data).sync for one in captured)


def test_unused_slots_of_a_turn_carry_null_frames():
    """Shares of records differ in length; the owner of two slots may need one."""
    short = run(rule="labelled", schedule="full", cluster="audi", payload_bytes=100, steps=6)
    captured = capture(short.setup, short.trace, short.messages)
    bus = short.plan
    assert captured is not None and isinstance(bus, FlexRayBus)
    frames = [decode_frame(one.data) for one in captured]
    owned = len(bus.table.static_slots(0))
    shares = sum(topic.startswith("share/") for topic, _ in short.messages)
    null = [frame for frame in frames if frame.null]
    assert len(frames) == 6 * 3 * owned
    assert len(null) == len(frames) - shares > 0
    assert not any(any(frame.payload) for frame in null)
    assert all(frame.sync for frame in frames if frame.frame_id % (owned // 5) == 1)


def test_a_capture_of_all_cycles_shows_a_bus_that_runs():
    few = run(cluster="demo", steps=3)
    used = capture(few.setup, few.trace, few.messages)
    every = capture(few.setup, few.trace, few.messages, all_cycles=True)
    assert used is not None and every is not None
    # Steps of 100 ms have ten cycles of 10 ms; five nodes own a slot in each.
    assert (len(used), len(every)) == (3 * 3 * 5, 30 * 5)
    assert set(used) <= set(every)
    for one in every:
        frame, number = decode_frame(one.data), int(one.time_us // 10_000)
        assert frame.cycle_count == number
        assert frame.null == (number % 10 >= 3)


def test_a_node_that_is_out_leaves_gaps_between_the_steps_too():
    killed = run(cluster="demo", steps=4, changes=("2 kill 3",))
    every = capture(killed.setup, killed.trace, killed.messages, all_cycles=True)
    assert every is not None
    of_killed = [one for one in every if decode_frame(one.data).frame_id == 4]
    assert len(of_killed) == 20 and max(one.time_us for one in of_killed) < 200_000


def test_a_capture_of_all_cycles_has_a_limit(capsys):
    said = concord(
        capsys, "run", "--scenario", "target-tracking", "--nodes", 20, "--steps", 100_000,
        "--schedule", "full", "--capture", "all",
    )  # fmt: skip
    assert "--capture all" in refused(said) and "--steps" in said.err


def test_the_capture_of_a_node_counts_what_that_node_counted():
    changes = ("2 corrupt 0.3", "2 loss 0.2", "3 crc 1 0.5", "4 babble 4 0.2", "6 calm")
    struck = run(steps=8, cluster="fitted-ab", changes=changes)
    wire = capture(struck.setup, struck.trace, struck.messages)
    traffic = traffic_of(struck.setup, struck.trace, struck.messages)
    assert wire is not None and traffic is not None
    lost = 0
    for node, counted in enumerate(struck.trace.counters):
        captured = node_capture(struck.setup, traffic, node)
        on_a = [one for one in captured if one.channel == "A"]
        assert len(captured) == 2 * len(on_a)
        own = [one for one in on_a if decode_sender(one, struck.setup) == node]
        heard = [one for one in on_a if one not in own]
        collided = [one for one in heard if flags(one) & 0x02]
        wrong = [one for one in heard if flags(one) and not flags(one) & 0x02]
        assert len(own) == counted["sent"]
        assert len(collided) == counted.get("rejected collision", 0)
        # A wrong bit is in the header, in its length, or behind it.
        checks = ("header-crc", "frame-crc", "length")
        assert len(wrong) == sum(counted.get(f"rejected {name}", 0) for name in checks) > 0
        lost += counted.get("lost", 0)
        two_neighbours = 2 * counted["sent"]
        assert len(heard) == two_neighbours - counted.get("lost", 0)
    assert lost > 0


def decode_sender(one: Captured, setup: Setup) -> int:
    """The owner of the slot at this time; shares of five nodes take one static slot each."""
    bus = build_bus(setup)
    in_cycle_us = one.time_us % bus.cycle_us
    slots = [bus.own_slot_us(node, 0) for node in range(setup.scenario.nodes)]
    return next(i for i, (first, last) in enumerate(slots) if first <= in_cycle_us < last)


def test_captures_of_nodes_are_files_of_the_run(tmp_path: Path, capsys):
    folder = tmp_path / "run"
    common = ("--scenario", "oscillator", "--nodes", 5, "--steps", 4, "--cluster", "demo")
    concord(capsys, "run", *common, "--loss", 0.3, "--capture-nodes", 1, 3, "--out", folder)
    sizes = [len(packets(folder / f"bus_node_{node}.pcap")) for node in (1, 3)]
    assert len(packets(folder / "bus.pcap")) == 60 > max(sizes)
    concord(capsys, "collect", folder, "--capture", "all")
    assert len(packets(folder / "bus.pcap")) == 40 * 5
    said = concord(capsys, "collect", folder, "--capture-nodes", 5)
    assert "capture-nodes" in refused(said) and "0 to 4" in said.err
