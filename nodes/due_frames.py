"""The short way of the frames that are due: nearly all come when, and as, they are expected.

The frame expected of a neighbour in the open cycle is known to the last bit but for the body and
its checksum. A frame that differs takes the slow path (`nodes/inbox.py`), which finds out what it
is. For a frame that is due, both paths give the same result.
"""

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from concord.nodes.estimator import Rejected
from concord.nodes.messages import NodeEvent, ShareHeard
from concord.nodes.node_state import NodeConfig, NodeState, Phase


def take_due(
    config: NodeConfig, state: NodeState, events: Sequence[NodeEvent]
) -> tuple[NodeState, Sequence[NodeEvent]]:
    """File the frames that are due, up to the first event that is none; returns the state and the
    events from there on."""
    is_open = state.phase is Phase.SHARES or state.phase is Phase.GRANT
    if not (is_open and config.hears_all):
        return state, events
    cycle, inbox, estimator = state.cycle, state.inbox, config.estimator
    size, due_body = estimator.share_bytes, config.bus.due_body
    due = list(config.groups(cycle)[state.group].neighbours)
    if inbox.shares or inbox.parts:
        known = inbox.shares.keys() | inbox.parts.keys()
        due = [j for j in due if (cycle, j) not in known]
    shares: dict[tuple[int, int], Any] = {}
    for event in events:
        if not isinstance(event, ShareHeard) or event.sender not in due:
            break
        sender = event.sender
        body = due_body(event.frame, sender, cycle, size)
        if body is None:
            break
        try:
            shares[cycle, sender] = estimator.accept(body)
        except Rejected:
            break
        due.remove(sender)
    if not shares:
        return state, events
    taken = len(shares)
    counters = {**state.counters, "heard": state.counters.get("heard", 0) + taken}
    inbox = replace(inbox, shares={**inbox.shares, **shares})
    return replace(state, counters=counters, inbox=inbox), events[taken:]


def cut_short(config: NodeConfig, state: NodeState) -> list[int]:
    """Return the neighbours whose share is cut in the open group, and whose frames have not all
    come.

    These frames are of no use. The node waits for them, so that it counts the same frames in every
    driver.
    """
    grant = state.inbox.grants.get((state.cycle, state.group))
    if grant is None or not grant.cut_shares:
        return []
    parts = {j: state.inbox.parts.get((state.cycle, j), {}) for j in grant.cut_shares}
    return [
        j
        for j, one in grant.cut_shares.items()
        if j in config.neighbours and j not in state.absent and len(parts[j]) < one.frames
    ]
