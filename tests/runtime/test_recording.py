"""A recording holds every message as it travelled, and can be read after any kind of end."""

import gc
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.runtime import in_process
from concord.runtime.recording import McapRecorder, MemoryRecorder, read_recording
from tests.nodes.networks import DECAYED, network, path, random_priors, run

ROUNDS, STEP_S = 2, 0.25
MESSAGES = run(
    network(
        path(2),
        random_priors(np.random.default_rng(0), 2, 2),
        steps=3,
        rounds=ROUNDS,
        hold_policy=DECAYED,
        seeing=[0],
    )
).messages


def write(path: Path, messages: list[tuple[str, bytes]]) -> tuple[bytes, bytes]:
    """The content of the file before the recorder was closed, and after."""
    recorder = McapRecorder(path, ROUNDS, STEP_S, SHARE_FRAMES)
    recorder.record(messages[:5])
    for message in messages[5:]:
        recorder.record([message])
    unclosed = path.read_bytes()
    recorder.close()
    return unclosed, path.read_bytes()


class Content(bytes):
    """Bytes that a failing test does not print."""

    def __repr__(self) -> str:
        return f"<{len(self)} bytes>"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Content:
    return Content(write(tmp_path_factory.mktemp("recording") / "run.mcap", MESSAGES)[1])


def test_what_is_recorded_is_read(tmp_path: Path):
    write(tmp_path / "run.mcap", MESSAGES)
    assert list(read_recording(tmp_path / "run.mcap")) == MESSAGES


def test_memory_and_file_keep_the_same(tmp_path: Path):
    memory = MemoryRecorder()
    for message in MESSAGES:
        memory.record([message])
    memory.close()
    write(tmp_path / "run.mcap", MESSAGES)
    assert memory.messages == list(read_recording(tmp_path / "run.mcap"))


def test_a_recording_that_is_not_closed_has_all_its_messages(tmp_path: Path):
    """The writer was killed between two messages."""
    unclosed, _ = write(tmp_path / "run.mcap", MESSAGES)
    (tmp_path / "run.mcap").write_bytes(unclosed)
    assert list(read_recording(tmp_path / "run.mcap")) == MESSAGES


def test_a_recording_cut_anywhere_has_the_messages_before_the_cut(tmp_path: Path, whole: Content):
    """Every position, in steps of a prime number; the end of the file byte by byte."""
    file = tmp_path / "cut.mcap"
    counts = []
    for cut in [*range(0, len(whole), 17), *range(len(whole) - 400, len(whole) + 1)]:
        file.write_bytes(whole[:cut])
        read = list(read_recording(file))
        assert read == MESSAGES[: len(read)]
        counts.append(len(read))
    assert counts[-1] == len(MESSAGES)
    assert sorted(set(counts)) == list(range(len(MESSAGES) + 1))


@given(st.data())
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_recording_cut_at_any_byte_is_read_up_to_the_cut(
    tmp_path: Path, whole: Content, data: st.DataObject
):
    file = tmp_path / "cut.mcap"
    one, other = sorted(data.draw(st.integers(0, len(whole))) for _ in range(2))
    file.write_bytes(whole[:one])
    fewer = list(read_recording(file))
    file.write_bytes(whole[:other])
    more = list(read_recording(file))
    assert fewer == MESSAGES[: len(fewer)]
    assert more == MESSAGES[: len(more)]
    assert len(fewer) <= len(more)


@pytest.mark.slow
def test_an_open_recording_cut_anywhere_is_readable_too(tmp_path: Path):
    file = tmp_path / "run.mcap"
    unclosed, _ = write(file, MESSAGES[:6])
    for cut in range(0, len(unclosed) + 1, 7):
        file.write_bytes(unclosed[:cut])
        read = list(read_recording(file))
        assert read == MESSAGES[: len(read)]


@pytest.mark.parametrize("content", [b"no recording", b"\x00" * 100, b"{}" * 50])
def test_what_is_no_recording_is_refused_by_name(tmp_path: Path, content: bytes):
    file = tmp_path / "run.mcap"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.mcap: not a recording of concord"):
        list(read_recording(file))


def test_other_tools_can_read_it(tmp_path: Path):
    """Foxglove and the mcap library: topics, JSON schemas, times of the plant in order."""
    write(tmp_path / "run.mcap", MESSAGES)
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        channels = {c.topic: c for c in summary.channels.values()}
        assert set(channels) == {topic for topic, _ in MESSAGES}
        assert channels["share/0"].message_encoding == "flexray"
        estimate = channels["estimate/1"]
        assert estimate.message_encoding == "json"
        assert summary.schemas[estimate.schema_id].encoding == "jsonschema"
        read = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
    assert sorted((t, d) for t, _, d in read) == sorted(MESSAGES)
    assert {time for _, time, _ in read} == {0, 250_000_000, 500_000_000}
    steps = [time for topic, time, _ in read if topic == "share/1"]
    assert steps == [0, 0, 250_000_000, 250_000_000, 500_000_000, 500_000_000]


class Interrupted(Exception):
    """Ctrl-C, in a form that a test can raise at any moment."""


def test_an_interruption_at_any_moment_leaves_a_readable_recording(tmp_path: Path):
    """Ctrl-C strikes between any two instructions, also within the recorder."""
    net = network(
        path(2), random_priors(np.random.default_rng(0), 2, 2), steps=200, rounds=1, seeing=[0]
    )
    whole = run(net).messages

    def strike(_signal, _frame):
        raise Interrupted

    before = signal.signal(signal.SIGALRM, strike)
    gc.disable()  # an interruption within somebody's hook of the collector is not ours to bear
    try:
        for attempt in range(40):
            file = tmp_path / f"{attempt}.mcap"
            recorder = McapRecorder(file, 1, STEP_S, SHARE_FRAMES)
            signal.setitimer(signal.ITIMER_REAL, 0.002 + attempt * 0.0007)
            try:
                in_process.run(net.environment, net.nodes, recorder)
                time.sleep(0.1)
            except Interrupted:
                pass
            recorder.close()
            read = list(read_recording(file))
            assert read == whole[: len(read)]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        gc.enable()
