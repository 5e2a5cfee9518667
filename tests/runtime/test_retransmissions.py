"""Test that a retransmission replaces a lost message and changes nothing elsewhere."""

import tracemalloc
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.nodes.faults.losses import LinkState
from concord.nodes.messages import NodeEvent, ShareHeard, decode, encode, topic
from concord.nodes.node import initial_state, step
from concord.nodes.node_state import NodeConfig, Phase
from concord.runtime.processes.republisher import Deduplication, is_missing
from tests.nodes.networks import SEEDS, Network, networks, run, with_links

Messages = list[tuple[str, bytes]]


def inbound(config: NodeConfig, said: Messages) -> list[NodeEvent]:
    """Return the messages that reach a node, in order."""
    events: list[NodeEvent] = []
    for name, data in said:
        kind, _, owner = name.partition("/")
        if name in (f"measured/{config.index}", "grant"):
            events.append(decode(name, data))
        elif kind == "share" and int(owner) in config.neighbours:
            events.append(ShareHeard(int(owner), data))
    return events


class Listener:
    """A node that is fed by hand."""

    def __init__(self, config: NodeConfig) -> None:
        self.config, self.state = config, initial_state(config)
        self.sent: Messages = []

    def hear(self, event: NodeEvent) -> None:
        self.state, messages = step(self.config, self.state, event)
        self.sent += [(topic(message), encode(message)) for message in messages]

    def hear_again(self, event: NodeEvent) -> None:
        if is_missing(self.state, event, SHARE_FRAMES):
            self.hear(event)


def own(config: NodeConfig, said: Messages) -> Messages:
    """Return the messages that a node sent."""
    kinds = ("share", "bid", "estimate")
    return [(name, data) for name, data in said if name in [f"{k}/{config.index}" for k in kinds]]


def meant(sent: Messages) -> list[tuple[str, Any]]:
    """Messages in the order of their bytes as what they say."""
    return [
        (name, data if name.startswith("share/") else decode(name, data))
        for name, data in sorted(sent)
    ]


@given(networks(), st.data(), st.floats(0, 0.5), SEEDS)
@settings(max_examples=40)
def test_what_has_come_is_not_taken_again(
    net: Network, data: st.DataObject, loss: float, fate: int
):
    """No bit of an estimate changes, and no counter; whatever links do to frames."""
    net = with_links(net, LinkState((fate, 0), loss))
    said = run(net).messages
    for config in net.nodes:
        node = Listener(config)
        events = inbound(config, said)
        for number, event in enumerate(events):
            node.hear(event)
            for place in data.draw(st.lists(st.integers(0, number), max_size=3)):
                node.hear_again(events[place])
        assert node.sent == own(config, said)


@given(networks(), st.data())
@settings(max_examples=40)
def test_what_was_lost_on_the_way_is_made_up_for(net: Network, data: st.DataObject):
    """Everything is said again until the node is done: its estimates are as if all had come."""
    said = run(net).messages
    for config in net.nodes:
        node = Listener(config)
        events = inbound(config, said)
        arrives = data.draw(st.lists(st.booleans(), min_size=len(events), max_size=len(events)))
        for event, comes in zip(events, arrives, strict=True):
            if comes:
                node.hear(event)
        for event in events:
            node.hear_again(event)
        assert node.state.phase is Phase.FINISHED
        # The order in which the counters began does not matter.
        assert meant(node.sent) == meant(own(config, said))


def test_a_recorder_keeps_what_is_said_again_once():
    remembered = Deduplication()
    assert remembered.what_is_new([("share/1", b"a"), ("share/2", b"b")], "keep/") == [
        ("share/1", b"a"),
        ("share/2", b"b"),
    ]
    again = [
        ("keep/share/1", b"a"),
        ("keep/share/1", b"c"),
        ("share/2", b"d"),
        ("keep/share/1", b"c"),
    ]
    assert remembered.what_is_new(again, "keep/") == [("share/1", b"c"), ("share/2", b"d")]


def test_what_was_heard_is_not_kept_to_be_remembered():
    remembered = Deduplication()
    tracemalloc.start()
    for number in range(100):
        remembered.what_is_new([("share/1", number.to_bytes(2, "big") * 500_000)], "keep/")
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept_bytes < 1_000_000
    assert remembered.what_is_new([("keep/share/1", bytes(1_000_000))], "keep/") == []
