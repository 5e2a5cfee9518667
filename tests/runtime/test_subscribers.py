"""The recorder hands the newest step over to a page that begins to listen."""

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.nodes.messages import decode
from concord.runtime.processes.recorder import subscribers
from concord.runtime.whole_steps import Handover, WholeSteps
from tests.dashboard.runs import run_of

RUN = run_of("target-tracking", nodes=4, steps=12)


class Offered:
    """A transport that keeps what would answer questions."""

    def __init__(self) -> None:
        self.answers: dict[str, Callable[[bytes], bytes]] = {}

    def answer(self, topic: str, reply: Callable[[bytes], bytes]) -> None:
        self.answers[topic] = reply

    def listened(self, topic: str, told: Callable[[bool], None]) -> None:
        """Forget the callback: this test has no subscribers."""

    def handed(self) -> Handover | None:
        answer = self.answers["handover"](b"")
        return msgspec.msgpack.decode(answer, type=Handover) if answer else None


def _offered() -> tuple[Offered, Any]:
    offered: Any = Offered()
    steps = WholeSteps(4, RUN.stage.rounds, SHARE_FRAMES)
    return offered, subscribers.Subscribers(offered, steps, lambda: None)


def test_the_newest_whole_step_and_all_readings_so_far_are_handed_over():
    offered, recorded = _offered()
    assert offered.handed() is None
    readings: list[tuple[str, bytes]] = []
    newest: list[int] = []
    for message in RUN.messages:
        recorded.tell([message])
        readings += [message] if message[0].startswith("measured/") else []
        handed = offered.handed()
        if handed is None:
            continue
        newest.append(handed.step.number)
        assert handed.readings is not None
        assert [step.number for step in handed.readings] == list(range(handed.step.number + 1))
        told = [one for step in handed.readings for one in step.messages]
        so_far = [one for one in readings if decode(*one).step <= handed.step.number]
        assert sorted(told) == sorted(so_far)
    assert sorted(set(newest)) == list(range(12))
    assert newest == sorted(newest)


def test_readings_that_would_fill_the_memory_are_not_kept(monkeypatch: pytest.MonkeyPatch):
    of_a_step = sum(len(data) for topic, data in RUN.messages if topic.startswith("measured/")) / 12
    monkeypatch.setattr(subscribers, "_MOST_READING_BYTES", 5 * of_a_step)
    offered, recorded = _offered()
    recorded.tell(RUN.messages)
    handed = offered.handed()
    assert handed is not None
    assert handed.step.number == 11
    assert handed.readings is None
