"""Pages on a network that is not there, that stands still, that is fast, and that they leave."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.frames.source import replayed
from concord.dashboard.serve import open_network
from concord.nodes.commands import in_words
from concord.runtime.network.control_client import Client, NotThere
from concord.runtime.network.network_file import read_network
from concord.runtime.processes.recorder.throttled_feed import AT_ONCE, STEPS_PER_S
from tests.processes import CONCORD, PROC, family, holds_within

pytestmark = pytest.mark.zenoh
ROOT = Path(__file__).resolve().parents[2]
NETWORK = ["--scenario", "oscillator", "--nodes", "3", "--steps", "1000000"]
_CONNECTED = "03"


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("live") / "run"
    command = (*CONCORD, "run", "--driver", "processes", *NETWORK, "--out", str(folder))
    with family(command, ROOT):
        assert holds_within(60.0, lambda: _runs(folder))
        yield folder


def _runs(folder: Path) -> bool:
    """Return whether the network has begun; while its processes start, none of them answers."""
    try:
        reach = read_network(folder)
        client = Client(reach.connect, reach.run)
    except ValueError:
        return False
    try:
        return client.state()["begun"]
    except NotThere:
        return False
    finally:
        client.close()


@pytest.fixture
def onlooker(network: Path) -> Iterator[Client]:
    """Yield a client that asks the network itself; the network runs as fast as it can."""
    reach = read_network(network)
    client = Client(reach.connect, reach.run)
    _say(client, "resume")
    yield client
    client.close()


@pytest.fixture
def page(network: Path, onlooker: Client) -> Iterator[LiveNetwork]:
    reach = read_network(network)
    source = LiveNetwork(reach.connect, reach.run)
    yield source
    source.close()


def _say(client: Client, what: str) -> None:
    assert client.command(in_words(what.split())).accepted


def _pause(client: Client) -> int:
    """The number of the last step, at which the network stands."""
    _say(client, "pause")
    assert holds_within(20.0, lambda: client.state()["completed"] == client.state()["released"])
    return client.state()["completed"] - 1


def _until(page: LiveNetwork, holds: Callable[[list[StepFrame]], bool]) -> list[StepFrame]:
    """Return the frames that a page receives until a condition on them holds."""
    frames: list[StepFrame] = []

    def heard() -> bool:
        frames.extend(page.poll())
        return holds(frames)

    assert holds_within(20.0, heard)
    return frames


def _texts(frames: list[StepFrame]) -> list[str]:
    return [event.text for frame in frames for event in frame.events]


def test_nobody_at_an_endpoint_is_said_in_one_sentence():
    started = time.monotonic()
    with pytest.raises(ValueError, match="no network answers"):
        LiveNetwork(["tcp/127.0.0.1:9"], "nobody")
    assert time.monotonic() - started < 15


def test_a_page_on_a_network_that_stands_still_shows_this_step_and_the_next(
    network: Path, onlooker: Client
):
    last = _pause(onlooker)
    reach = read_network(network)
    page = LiveNetwork(reach.connect, reach.run)
    try:
        (frame,) = _until(page, lambda frames: bool(frames))
        assert frame.step == last > 0
        assert all(cycle.payload_bytes for cycle in frame.cycles)
        # A page that heard the run from its beginning shows the same, its centralised filter too.
        told = replayed(page.stage, network / "run.mcap")
        heard = next(one for one in told if one.step == last)
        np.testing.assert_array_equal(frame.belief.mean, heard.belief.mean)
        np.testing.assert_array_equal(frame.belief.cov, heard.belief.cov)
        np.testing.assert_array_equal(frame.ages, heard.ages)
        assert frame.scores.central == heard.scores.central > 0
        assert frame.scores.rmse == heard.scores.rmse
        for step in (last + 1, last + 2):
            _say(onlooker, "step 1")
            frames = _until(page, lambda frames, step=step: step in [f.step for f in frames])
            # The step at which the network stands may be on its way to us still.
            assert [frame.step for frame in frames if frame.step > last] == [step]
            assert frames[-1].scores.central > 0
            assert all(cycle.payload_bytes for cycle in frames[-1].cycles)
            assert not np.isnan(frames[-1].belief.mean).any()
    finally:
        page.close()


def test_of_a_fast_network_a_page_sees_some_steps_all_events_and_the_last(
    page: LiveNetwork, onlooker: Client
):
    began_s = time.monotonic()
    first = onlooker.state()["completed"]
    frames = _until(page, lambda _: onlooker.state()["completed"] > first + 400)
    _say(onlooker, "cut 0 1")
    frames += _until(page, lambda _: onlooker.state()["completed"] > first + 900)
    _say(onlooker, "heal")
    frames += _until(page, lambda _: onlooker.state()["completed"] > first + 1400)
    last = _pause(onlooker)
    frames += _until(page, lambda frames: bool(frames) and frames[-1].step == last)
    elapsed_s = time.monotonic() - began_s
    # A page may catch up AT_ONCE steps; and there are those of a moment before we began to count.
    assert len(frames) <= 10 + AT_ONCE + STEPS_PER_S * elapsed_s
    steps = [frame.step for frame in frames]
    assert steps == sorted(set(steps))
    wanted = ("link 00 → 01 cut", "link 01 → 00 cut", "link 00 → 01 healed")
    texts = _texts(frames)
    # On a busy machine a full link drops events, and a page asks for them with each further step.
    for further in range(last + 1, last + 40):
        if all(text in texts for text in wanted):
            break
        _say(onlooker, "step 1")
        texts += _texts(_until(page, lambda new, step=further: step in [one.step for one in new]))
    assert [texts.count(text) for text in wanted] == [1, 1, 1]
    # Totals know of the steps that were left out: a share per node and cycle, and cut ones.
    for frame in frames:
        assert (frame.traffic.sent == frame.traffic.sent[0]).all()
        assert frame.traffic.sent[0] == (frame.step + 1) * len(frame.cycles)


def test_changes_that_others_ask_for_wait_on_the_page_of_a_paused_network(
    page: LiveNetwork, onlooker: Client
):
    def waits(*words: str) -> bool:
        page.poll()
        return tuple(one.words for one in page.pace().pending if one.words) == words

    last = _pause(onlooker)
    for words in ("cut 0 1", "kill 2"):
        _say(onlooker, words)
    asked = ("cut 0 1 one-way", "cut 1 0 one-way", "kill 2")
    assert holds_within(20.0, lambda: waits(*asked))
    _say(onlooker, "step 1")
    frames = _until(page, lambda frames: bool(frames) and frames[-1].step == last + 1)
    words = [event.words for frame in frames for event in frame.events]
    assert set(asked) <= set(words)
    assert holds_within(20.0, waits)
    for words in ("calm", "restart 2"):
        _say(onlooker, words)
    assert holds_within(60.0, lambda: waits("calm", "restart 2"))


def test_a_page_for_spectators_shows_the_network_and_sends_no_command(
    network: Path, onlooker: Client
):
    reach = read_network(network)
    source = LiveNetwork(reach.connect, reach.run, read_only=True)
    dashboard = open_network(source, network, "127.0.0.1", 0, light=False)
    try:
        for command in ({"do": "pause"}, {"do": "kill", "node": 1}, {"do": "speed"}):
            answer = source.ask(command)
            assert not answer.accepted
            assert answer.detail == f"{command['do']}: this page is read-only"
        assert dashboard.controls.network is None
        assert dashboard.controls.node is None
        assert not dashboard.controls.pause.visible
        assert _until(source, lambda frames: len(frames) > 3)
        state = onlooker.state()
        assert not state["paused"]
        assert state["members"] == [0, 1, 2]
    finally:
        dashboard.close()


@pytest.mark.skipif(not PROC.is_dir(), reason="counts connections in /proc, which is not there")
def test_to_who_has_left_nothing_is_sent_and_nobody_misses_him(
    network: Path, onlooker: Client, page: LiveNetwork
):
    socket = read_network(network).connect[0].removeprefix("unixsock-stream/")
    assert holds_within(20.0, lambda: len(_connected(socket)) == 2)
    seen = _until(page, lambda frames: len(frames) > 3)
    page.close()
    # Only the onlooker is still connected, and it receives no frames.
    assert holds_within(20.0, lambda: len(_connected(socket)) == 1)
    completed = onlooker.state()["completed"]
    assert holds_within(20.0, lambda: onlooker.state()["completed"] > completed + 50)
    assert onlooker.state()["members"] == [0, 1, 2]
    again = LiveNetwork(read_network(network).connect, None)
    try:
        frames = _until(again, lambda frames: len(frames) > 3)
    finally:
        again.close()
    assert frames[-1].alive.all()
    assert (frames[-1].traffic.missed == seen[-1].traffic.missed).all()


def _connected(socket: str) -> list[str]:
    """Connections that others have to a unix socket of this machine."""
    rows = [row.split() for row in (PROC / "net" / "unix").read_text().splitlines()[1:]]
    return [row[6] for row in rows if row[-1] == socket and row[5] == _CONNECTED]


class Deaf(deque[tuple[str, bytes]]):
    """The messages that a page hears, without events."""

    def append(self, message: tuple[str, bytes]) -> None:
        if message[0] != "event":
            super().append(message)


def test_an_event_that_a_full_link_drops_is_asked_for(
    page: LiveNetwork, onlooker: Client, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(page, "_heard", Deaf(page._heard))
    ask, silent = page._client.events, [True]
    # The first question has no answer, and after the step the network stands still.
    monkeypatch.setattr(page._client, "events", lambda: [] if silent and silent.pop() else ask())
    _pause(onlooker)
    _say(onlooker, "cut 0 1")
    _say(onlooker, "step 1")
    frames = _until(page, lambda frames: any(frame.events for frame in frames))
    texts = [event.text for frame in frames for event in frame.events]
    assert {"link 00 → 01 cut", "link 01 → 00 cut"} <= set(texts)
