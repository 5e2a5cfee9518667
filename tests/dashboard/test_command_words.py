"""Commands in words, their waiting while a network is paused, and the speed in force."""

import time
from collections.abc import Callable, Iterator
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest

from concord.dashboard.app import Dashboard
from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.frame import LogEntry
from concord.dashboard.frames.source import CommandAnswer, SourceState
from concord.dashboard.panels.commands import in_a_sentence
from concord.dashboard.serve import open_network
from concord.runtime.whole_steps import WholeSteps
from tests.dashboard.runs import frames_of, run_of

RUN = run_of("target-tracking", nodes=8, steps=12)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"do": "kill", "node": 2}, "kill node 02"),
        ({"do": "restart", "node": 2}, "restart node 02"),
        ({"do": "cut", "sender": 1, "receiver": 7}, "cut the link between 01 and 07"),
        (
            {"do": "cut", "sender": 1, "receiver": 7, "both": False},
            "cut the link from 01 to 07",
        ),
        ({"do": "heal"}, "heal every link"),
        (
            {"do": "loss", "probability": 0.25, "sender": 1, "receiver": 7},
            "lose 25 % of the frames on the link between 01 and 07",
        ),
        ({"do": "loss", "probability": 0.1}, "lose 10 % of the frames on every link"),
        ({"do": "partition", "nodes": (1, 2)}, "cut nodes 01, 02 off from the others"),
        ({"do": "fault", "kind": "hang", "nodes": (3,), "numbers": (5.0,)}, "fault hang 03 5"),
        ({"do": "set", "settings": {"rule": "ci", "rounds": 2}}, "set rule to ci, rounds to 2"),
        ({"do": "speed", "steps_per_second": 5}, "at most 5 steps per second"),
        ({"do": "speed", "steps_per_second": 0}, "as fast as possible"),
        ({"do": "calm"}, "withdraw all faults"),
    ],
)  # fmt: skip
def test_a_command_is_said_as_a_person_says_it(command: dict, words: str):
    assert in_a_sentence(command, RUN.stage.names) == words


class Scripted:
    """A live source whose state a test sets, and which accepts all commands."""

    live = takes_commands = True
    stage = RUN.stage

    def __init__(self) -> None:
        self.frames = frames_of(RUN.stage, RUN.messages)[:6]
        self.state = SourceState("PAUSED", "6 of 12 steps", 6, 5.0)
        self.asked: list[str] = []

    def poll(self):
        frames, self.frames = self.frames, []
        return frames

    def pace(self) -> SourceState:
        return self.state

    def ask(self, command) -> CommandAnswer:
        self.asked.append(command["do"])
        return CommandAnswer(True, "")

    def close(self) -> None:
        self.frames = []


@pytest.fixture
def source() -> Scripted:
    return Scripted()


@pytest.fixture
def page(source: Scripted) -> Iterator[Dashboard]:
    live: object = source
    shown = open_network(live, None, "127.0.0.1", 0, light=False)  # type: ignore[arg-type]
    yield shown
    shown.close()


def holds(page: Dashboard, condition: Callable[[], bool]) -> bool:
    """Whether something comes to hold while the page is drawn."""
    for number in range(200):
        page.tick(10.0 + number)
        if condition():
            return True
        time.sleep(0.02)
    return False


def test_changes_of_a_paused_network_wait_in_words_until_its_next_step(
    page: Dashboard, source: Scripted
):
    told: list[str] = []
    page.controls.commands.tell = lambda client, title, body, trouble: told.append(body)
    assert holds(page, lambda: "PAUSED" in page.controls.status.content)
    assert "waiting" not in page.controls.status.content
    page.controls.commands.send({"do": "kill", "node": 2}, None)
    # The network announces all changes, also those that others have asked for.
    said = ("kill 2", "cut 1 7 one-way", "cut 7 1 one-way", "")
    pending = tuple(LogEntry(6, "", words=words) for words in said)
    source.state = source.state._replace(pending=pending)
    words = "2 changes from the next step on: kill node 02; cut the link between 01 and 07"
    assert holds(page, lambda: words in page.controls.status.content)
    assert told[0] == "Kill node 02. It holds from the next step, which waits for Step or Resume."
    source.state = source.state._replace(completed=7, pending=())
    assert holds(page, lambda: "waiting" not in page.controls.status.content)


def test_a_page_on_a_paused_network_says_that_it_waits_for_a_step(
    page: Dashboard, source: Scripted
):
    source.frames, frames = [], source.frames
    words = "no step yet; press Step, or N"
    assert holds(page, lambda: words in page.controls.status.content)
    # Nothing is drawn in place of what is not known.
    assert all(not len(chart.times) for chart in page.page.charts.drawn)
    assert page.page.charts.beginning.visible
    source.frames = frames
    assert holds(page, lambda: words not in page.controls.status.content)
    assert holds(page, lambda: not page.page.charts.beginning.visible)


def test_the_filter_that_hears_everything_is_not_begun_in_the_middle():
    whole = WholeSteps(RUN.stage.nodes, RUN.stage.rounds, RUN.stage.bus.frame_format)
    steps = [step for topic, data in RUN.messages for step in whole.take(topic, data)]
    from_start, from_middle = Assembler(RUN.stage), Assembler(RUN.stage)
    for first, assembler in ((0, from_start), (5, from_middle)):
        frames = [frame for frame in map(assembler.frame, steps[first:]) if frame is not None]
        assert len(frames) == len(steps) - first
        assert all(np.isfinite(frame.scores.central) == (first == 0) for frame in frames)


@pytest.mark.parametrize("state", ["PAUSED", "SILENT", "RUNNING"])
def test_a_press_on_resume_resumes_whatever_has_come_before_its_turn(
    page: Dashboard, source: Scripted, state: str
):
    assert holds(page, lambda: page.controls.pause.label == "Resume")
    turn = Event()
    page.controls.commands.soon(turn.wait)
    for _ in range(2):
        page.controls.toggle(None)
    source.state = source.state._replace(state=state)
    turn.set()
    assert holds(page, lambda: len(source.asked) == 2)
    assert source.asked == ["resume", "resume"]


def test_a_drag_ends_on_the_ground_and_says_so_of_the_sky(page: Dashboard, source: Scripted):
    told: list[str] = []
    page.controls.commands.tell = lambda client, title, body, trouble: told.append(body)
    assert holds(page, lambda: page.page.scene.at is not None)
    at, hand = page.page.scene.at, page._hand
    assert at is not None
    assert hand is not None
    above = SimpleNamespace(camera=SimpleNamespace(position=(0.0, 0.0, 60.0)))
    for end in (at[2], np.array([30.0, 30.0, 70.0]), np.array([3.0, -3.0, 0.15])):
        drag = {"instance_index": 2, "phase": "end", "end_position": end, "client": above}
        hand._drag(SimpleNamespace(**drag))
    assert "a drag ends at another node" in told[0]
    assert holds(page, lambda: len(told) == 2)
    assert told[1].startswith("Set placement to 2@")
    assert source.asked == ["set"]


def test_the_slider_shows_the_speed_in_force(page: Dashboard, source: Scripted):
    assert holds(page, lambda: page.controls.speed.value == 5)
    source.state = source.state._replace(steps_per_s=0.0)
    assert holds(page, lambda: page.controls.speed.value == 0)


def test_the_page_of_a_network_that_has_ended_plays_what_it_has_received(
    page: Dashboard, source: Scripted
):
    assert holds(page, lambda: page.view.step == 5)
    source.state = SourceState("ENDED", "12 of 12 steps")
    assert holds(page, lambda: page.controls.pause.label == "Resume")
    assert holds(page, lambda: page.controls.speed.label == "Speed")
    assert not page.controls.pause.disabled
    assert page.controls.network is not None
    assert page.controls.network.apply.disabled
    page.controls.toggle(None)
    # From the beginning, as the last step was shown.
    assert holds(page, lambda: page.view.playing and page.view.step < 5)
    assert "ENDED" in page.controls.status.content
    assert holds(page, lambda: page.view.step == 5 and not page.view.playing)
