"""Test the republisher beside a transport that stands still."""

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import pytest

from concord.runtime.network.links import ENVIRONMENT, RECORDER
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes import republisher
from tests.processes import holds_within


class Standing:
    """A transport that publishes nothing until it may."""

    def __init__(self) -> None:
        self.may, self.sent = threading.Event(), list[tuple[str, bytes]]()

    def send(self, topic: str, data: bytes) -> None:
        self.may.wait(20)
        self.sent.append((topic, data))


def of_node(transport: Standing) -> republisher.Republisher:
    return republisher.Republisher(cast(Transport, transport), "node 0", "estimate", 8, lambda: "")


def of_environment(
    transport: Standing, standing: Callable[[], list[tuple[str, bytes]]] = list
) -> republisher.Republisher:
    return republisher.Republisher(
        cast(Transport, transport), "the environment", "truth", 8, lambda: "", standing
    )


def told_by(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the first words on standard error, awaited for 20 s."""
    told = ""

    def has_told() -> bool:
        nonlocal told
        told += capsys.readouterr().err
        return bool(told)

    assert holds_within(20, has_told)
    return told


def test_repeats_follow_the_length_of_a_step():
    """200 processes on two cores have steps of a second, in which none has lost anything."""
    assert republisher.quiet_s(()) == republisher.quiet_s((5.0,)) == 1.0
    assert republisher.quiet_s((0.0, 0.01, 0.02)) == 1.0
    assert republisher.quiet_s((0.0, 0.5, 2.0, 2.1)) == pytest.approx(6.0)
    # After a pause of an hour a lost message still comes back soon.
    assert republisher.quiet_s((0.0, 3600.0)) == 10.0


def test_a_process_repeats_later_if_its_steps_take_long(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(republisher, "_AGAIN_S", 0.01)
    transport = Standing()
    transport.may.set()
    speaker = of_node(transport)
    for _ in range(2):
        speaker.say("estimate/0", b"{}")
        time.sleep(0.25)
    speaker.say("share/0", b"{}")
    began_s = time.monotonic()
    speaker.begin()
    assert holds_within(20, lambda: any(topic.startswith("again/") for topic, _ in transport.sent))
    # Four steps of a quarter of a second, looked at every hundredth.
    assert time.monotonic() - began_s > 0.9
    speaker.close()


def test_who_sees_links_break_never_waits_for_one_that_stands_still(
    monkeypatch: pytest.MonkeyPatch,
):
    """That thread is the one that sends: zenoh has no other."""
    monkeypatch.setattr(republisher, "_AGAIN_S", 0.01)
    transport = Standing()
    speaker = of_node(transport)
    speaker.begin()
    speaking = threading.Thread(target=speaker.say, args=("share/0", b"a"))
    speaking.start()
    time.sleep(0.1)  # By now it has looked what it may forget.
    seeing = threading.Thread(target=speaker.see, args=("1", False))
    seeing.start()
    seeing.join(5)
    is_waiting = seeing.is_alive()
    transport.may.set()
    for thread in (speaking, seeing):
        thread.join()
    speaker.close()
    assert not is_waiting


def test_a_link_is_back_that_was_broken_and_not_one_that_is_there_at_first():
    """A process that confused the two cases sent its hello twice and then stood still."""
    speaker = of_node(Standing())
    assert not speaker.see(ENVIRONMENT, True)
    assert not speaker.see(ENVIRONMENT, False)
    assert speaker.see(ENVIRONMENT, True)
    assert not speaker.see(ENVIRONMENT, True)


def test_a_link_that_has_just_come_back_may_drop_what_is_said_on_it(
    monkeypatch: pytest.MonkeyPatch,
):
    """The recording of a network had nodes that joined, and none that had gone."""
    monkeypatch.setattr(republisher, "_AGAIN_S", 0.05)
    heard = list[tuple[str, bytes]]()
    knows_who_listens = threading.Event()

    class Deaf(Standing):
        def send(self, topic: str, data: bytes) -> None:
            if knows_who_listens.is_set():
                heard.append((topic, data))

    speaker = of_environment(Deaf())
    speaker.begin()
    speaker.see(RECORDER, False)
    speaker.see(RECORDER, True)
    speaker.say("event", b"gone")
    knows_who_listens.set()
    assert holds_within(30, lambda: ("keep/event", b"gone") in heard)
    speaker.close()


def test_who_waits_for_the_recorder_at_its_end_says_so_and_repeats_what_it_may_have_lost(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """A recorder that had stood still lost the last message: all waited for ever, and none said
    for whom."""
    monkeypatch.setattr(republisher, "_AGAIN_S", 0.01)
    monkeypatch.setattr(republisher, "_AT_MOST_S", 0.01)
    monkeypatch.setattr(republisher, "_TELL_S", 0.05)
    transport = Standing()
    transport.may.set()
    speaker = of_environment(transport)
    speaker.begin()
    speaker.say("finished", b"a")
    assert holds_within(20, lambda: ("again/finished", b"a") in transport.sent)
    assert ("keep/finished", b"a") not in transport.sent
    speaker.finish()
    assert holds_within(20, lambda: ("keep/finished", b"a") in transport.sent)
    assert "for the recorder, which has not said that it has all messages" in told_by(capsys)
    speaker.close()


def test_nothing_new_is_said_to_a_recorder_before_what_it_has_lost():
    transport = Standing()
    transport.may.set()
    speaker = of_node(transport)
    speaker.begin()
    speaker.say("share/0", b"a")
    speaker.see(RECORDER, False)
    speaking = threading.Thread(target=speaker.say, args=("share/0", b"b"))
    speaking.start()
    speaking.join(0.05)
    assert speaking.is_alive()
    speaker.see(RECORDER, True)
    speaking.join()
    speaker.close()
    assert [one for one in transport.sent if not one[0].startswith("again/")] == [
        ("share/0", b"a"),
        ("keep/share/0", b"a"),
        ("share/0", b"b"),
    ]


def test_what_holds_is_said_where_nobody_goes_on(monkeypatch: pytest.MonkeyPatch):
    """Lasting facts, such as departed nodes, are sent again: one process may lack the last news."""
    monkeypatch.setattr(republisher, "_AGAIN_S", 0.01)
    transport = Standing()
    transport.may.set()
    speaker = of_environment(transport, lambda: [("gone", b"3")])
    speaker.begin()
    assert holds_within(20, lambda: ("gone", b"3") in transport.sent)
    speaker.close()


def test_a_wait_for_the_recorder_is_as_long_as_its_link_is_away(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """An environment that had nothing to keep for 1036 s said to have waited so long."""
    monkeypatch.setattr(republisher, "_AGAIN_S", 0.01)
    monkeypatch.setattr(republisher, "_AT_MOST_S", 0.01)
    monkeypatch.setattr(republisher, "_TELL_S", 0.2)
    now_s = 1000.0
    monkeypatch.setattr(republisher, "time", SimpleNamespace(monotonic=lambda: now_s))
    transport = Standing()
    transport.may.set()
    speaker = of_environment(transport)
    speaker.begin()
    speaker.say("event", b"a")
    assert holds_within(20, lambda: ("again/event", b"a") in transport.sent)
    now_s = 2036.0
    speaker.see(RECORDER, False)
    now_s = 2039.0
    told = told_by(capsys)
    speaker.close()
    assert told.startswith("the environment has waited 3 s for the recorder")
