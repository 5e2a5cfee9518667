"""The short way of the frames that are due: nearly all come when, and as, they are expected.

What is expected of a neighbour in the open cycle is known to the last bit but for the body and its
checksum. Whatever differs takes the long way (`nodes/hearing.py`), which finds out what it is; a
frame that is due would come to the same there.
"""

from collections.abc import Sequence

from msgspec.structs import replace

from nodes.estimator import Rejected
from nodes.messages import NodeEvent, ShareHeard
from nodes.node_state import NodeConfig, NodeState, Phase
from nodes.share import whole_body


def take_due(
    config: NodeConfig, state: NodeState, events: Sequence[NodeEvent]
) -> tuple[NodeState, Sequence[NodeEvent]]:
    """File the frames that are due, up to the first event that is none; returns the state and the
    events from there on."""
    is_open = state.phase is Phase.SHARES or state.phase is Phase.GRANT
    if not is_open or config.faults.standing or not config.links.perfect:
        return state, events
    cycle, inbox, size = state.cycle, state.inbox, config.estimator.share_bytes
    senders = config.schedule.static_senders(cycle)
    shares, counters = inbox.shares.copy(), state.counters.copy()
    taken = 0
    for event in events:
        if not isinstance(event, ShareHeard):
            break
        sender, key = event.sender, (cycle, event.sender)
        if sender not in senders or sender not in config.neighbours:
            break
        if key in shares or key in inbox.parts:
            break
        slot = config.slots(sender, cycle)[0]
        body = whole_body(event.frame, slot, size, cycle, config.cycle_counts)
        if body is None:
            break
        try:
            shares[key], heard = config.estimator.accept(body), "heard"
        except Rejected as rejected:
            shares[key], heard = None, f"rejected {rejected.reason}"
        counters[heard] = counters.get(heard, 0) + 1
        taken += 1
    if not taken:
        return state, events
    return replace(state, counters=counters, inbox=replace(inbox, shares=shares)), events[taken:]
