"""The rights of processes topic by topic: the golden table of least privilege.

The product lists topics by process; this table lists processes by topic. A right that the product
gives and the table does not name, or the other way round, fails the test.
"""

import re

import pytest

from concord.features.hosts.access_control import rights

ENVIRONMENT, NOBODY, ALL = (
    {"environment"},
    set(),
    {"environment", "recorder", "monitor", "operator"},
)
WATCHERS = {"recorder", "monitor", "operator"}
NODES = {"node-0", "node-1"}
# Topic below concord/<run>/: (processes that may publish it, processes that may hear it).
PUBLISHED: dict[str, tuple[set[str], set[str]]] = {
    "hello/0": ({"node-0"}, ALL),
    "bid/1": ({"node-1"}, ALL),
    "share/0": ({"node-0"}, WATCHERS | NODES),
    "estimate/1": ({"node-1"}, ALL),
    "timing/0": ({"node-0"}, WATCHERS),
    "unreachable/1": ({"node-1"}, ALL),
    "start": (ENVIRONMENT, WATCHERS | NODES),
    "measured/0": (ENVIRONMENT, WATCHERS | {"node-0"}),
    "grant": (ENVIRONMENT, WATCHERS | NODES),
    "truth": (ENVIRONMENT, WATCHERS),
    "finished": (ENVIRONMENT, WATCHERS),
    "event": (ENVIRONMENT, WATCHERS),
    "end": ({"environment", "recorder"}, ALL | NODES),
    "gone": (ENVIRONMENT, WATCHERS | NODES),
    "gone/1": (ENVIRONMENT, WATCHERS | {"node-1"}),
    "welcome/0": (ENVIRONMENT, WATCHERS | {"node-0"}),
    "recorded/0": ({"recorder"}, ALL | {"node-0"}),
    "recorded/environment": ({"recorder"}, ALL),
    "watch/estimate": ({"recorder"}, WATCHERS),
    "again/hello/0": ({"node-0"}, ALL),
    "again/bid/0": ({"node-0"}, ALL),
    "again/share/1": ({"node-1"}, WATCHERS | NODES),
    "again/estimate/0": ({"node-0"}, ALL),
    "again/measured/1": (ENVIRONMENT, WATCHERS | {"node-1"}),
    "again/grant": (ENVIRONMENT, WATCHERS | NODES),
    "keep/share/0": ({"node-0"}, WATCHERS),
    "keep/estimate/1": ({"node-1"}, WATCHERS),
    "keep/truth": (ENVIRONMENT, WATCHERS),
    "control": (NOBODY, WATCHERS),
    "share/2": (NOBODY, WATCHERS | NODES),
    "anything/else": (NOBODY, WATCHERS),
}
TOKENS = {"ready/0": {"node-0"}, "ready/1": {"node-1"}, "ready/environment": {"environment"},
          "ready/recorder": {"recorder"}, "ready/monitor": NOBODY}  # fmt: skip
QUERIES = {
    "state": (ENVIRONMENT, WATCHERS | NODES),
    "clock": (ENVIRONMENT, NODES),
    "control": (ENVIRONMENT, {"operator"}),
    "handover": ({"recorder"}, {"monitor", "operator"}),
    "welcome/0": (NOBODY, NOBODY),
}


def includes(key: str, topic: str) -> bool:
    """Return whether a key expression includes a topic: `*` is a part of one, `**` any parts."""
    parts = {"*": "[^/]+", "**": ".*"}
    pattern = "/".join(parts.get(part) or re.escape(part) for part in key.split("/"))
    return re.fullmatch(pattern, topic) is not None


def holders(kind: str, topic: str) -> set[str]:
    """The processes of a network of two nodes whose rights of a kind include a topic."""
    return {
        name
        for name, one in rights(2).items()
        if any(includes(key, topic) for key in getattr(one, kind))
    }


@pytest.mark.parametrize("topic", PUBLISHED)
def test_a_topic_is_published_and_heard_by_those_named(topic: str):
    says, hears = PUBLISHED[topic]
    assert holders("says", topic) == says
    assert holders("hears", topic) == hears


@pytest.mark.parametrize("topic", TOKENS)
def test_a_token_belongs_to_its_process(topic: str):
    assert holders("is_ready", topic) == TOKENS[topic]


@pytest.mark.parametrize("topic", QUERIES)
def test_a_query_is_answered_and_asked_by_those_named(topic: str):
    answers, asks = QUERIES[topic]
    assert holders("answers", topic) == answers
    assert holders("asks", topic) == asks


def test_every_right_is_in_the_table():
    """A right to a topic that the table lacks would be seen by no other test."""
    heard = PUBLISHED | TOKENS
    topics = {"says": PUBLISHED, "hears": heard, "is_ready": TOKENS, "answers": QUERIES,
              "asks": QUERIES}  # fmt: skip
    # A retransmission is judged like its message; the table has one of each kind of sender.
    for name, one in rights(2).items():
        for kind, known in topics.items():
            for key in getattr(one, kind):
                bare = key.removeprefix("again/").removeprefix("keep/")
                covered = any(
                    includes(some, topic)
                    for topic in known
                    for some in (key, bare, bare.replace("/1", "/0"), bare.replace("/0", "/1"))
                )
                assert covered, f"{name} {kind} {key}"
