"""Changes of a network: each does what it says from its step on, and says it in the log."""

from typing import Any

import pytest

from concord.dashboard.frames.network import AnnouncedChange, NetworkStatus, changed, read_change
from concord.dashboard.frames.stage import restaged, set_stage
from tests.dashboard.runs import event, setup_of

NAMES = ("00", "01", "02", "03")
START = NetworkStatus(frozenset(range(4)), (0, 0, 3))


def after(*changes: dict[str, Any], step: int = 5) -> NetworkStatus:
    network = START
    for facts in changes:
        network, _ = changed(network, AnnouncedChange(step, facts["what"], facts), NAMES)
    return network


def test_who_leaves_is_no_member_until_it_joins():
    assert after({"what": "left", "node": 2}).members == {0, 1, 3}
    assert after({"what": "gone", "node": 2}).members == {0, 1, 3}
    back = after({"what": "gone", "node": 2}, {"what": "joined", "node": 2, "mean": [], "cov": []})
    assert back.members == START.members


def test_a_link_is_cut_in_the_direction_that_is_named():
    cut = after({"what": "cut", "sender": 1, "receiver": 2})
    assert cut.cut == {(1, 2)}
    healed = {"what": "healed", "sender": 1, "receiver": 2}
    assert after({"what": "cut", "sender": 1, "receiver": 2}, healed).cut == frozenset()


def test_loss_is_that_of_a_link_or_of_all():
    one = after({"what": "loss", "probability": 0.25, "sender": 1, "receiver": 2})
    assert (dict(one.losses), one.loss) == ({(1, 2): 0.25}, 0.0)
    assert after({"what": "loss", "probability": 0.25}).loss == 0.25


def test_rounds_count_from_the_cycle_that_is_told():
    network = after({"what": "settings", "settings": {"rounds": 2}, "first_cycle": 15})
    assert list(network.cycles(5)) == [15, 16]
    assert list(network.cycles(7)) == [19, 20]
    assert list(START.cycles(4)) == [12, 13, 14]


def test_the_log_says_it_in_words():
    _, line = changed(START, AnnouncedChange(7, "cut", {"sender": 1, "receiver": 2}), NAMES)
    assert (line.step, line.text, line.trouble) == (7, "link 01 → 02 cut", True)
    _, line = changed(
        START, AnnouncedChange(7, "pace", {"paused": False, "steps_per_second": 20}), NAMES
    )
    assert line.text == "running, at most 20 steps per second"


@pytest.mark.parametrize("data", [b"", b"[]", b"{}", b'{"step":"x","change":{"what":"cut"}}', b"7"])
def test_what_says_nothing_is_nothing(data: bytes):
    assert read_change(data) is None


def test_a_told_change_is_read():
    change = read_change(event(3, what="gone", node=1)[1])
    assert change is not None
    assert (change.step, change.what, change.facts["node"]) == (3, "gone", 1)


def test_settings_change_the_bus_that_is_drawn():
    stage = set_stage(setup_of("target-tracking", nodes=8, steps=2))
    assert len(stage.bus.schedule.static_senders(0)) == 8
    other = restaged(stage, {"occupancy": 0.25, "schedule": "hybrid", "rounds": 1, "rule": "wac"})
    assert len(other.bus.schedule.static_senders(0)) < 8
    assert (other.rounds, other.setup.scenario.rule.name) == (1, "wac")
    assert (stage.rounds, stage.setup.scenario.rule.name) == (3, "ci")
