"""The ladder of a lockstep step: its rungs pass the same messages and add up to the network."""

import pytest

from benchmarks import ladder, node_loop
from benchmarks.lockstep import load_of, setup_of, traffic_of
from concord.runtime.drivers import in_memory

pytestmark = pytest.mark.slow


def test_every_rung_reads_the_messages_of_a_network(monkeypatch: pytest.MonkeyPatch):
    """A rung that lacked a message, or read another one than its own, would end with an error."""
    steps = 4
    for module in (ladder, node_loop):
        monkeypatch.setattr(module, "STEPS", steps)
    setup = setup_of(steps)
    messages = in_memory(setup)
    traffic = traffic_of(messages)
    for says in (False, True):
        assert node_loop.bare_node_s(load_of(setup, traffic, says), messages, False) > 0
    for rung in (ladder._transitions, ladder._environment, ladder._recorder):
        assert rung(setup, messages) > 0
    assert node_loop.node_s(setup, messages, False) > 0


def test_the_rungs_of_a_step_add_up_to_the_network(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    for module in (ladder, node_loop):
        monkeypatch.setattr(module, "STEPS", 4)
    monkeypatch.setattr(ladder, "TURNS", 1)
    monkeypatch.setattr(ladder, "_network_us", lambda *_: {"bytes": 2e5, "lockstep": 5e5})
    found = ladder.main()
    rungs = [one.value for name, one in found.items() if name != "lockstep us"]
    assert sum(rungs) == pytest.approx(5e5)
    assert "up to here 100.0%" in capsys.readouterr().out
