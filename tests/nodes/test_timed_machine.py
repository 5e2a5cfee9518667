"""A timed network: a part of a cycle ends by the clock, and gives what lockstep gives."""

import dataclasses

from msgspec import UNSET

from concord.nodes import environment
from concord.nodes import node as state_machine
from concord.nodes.messages import (
    Allowed,
    Bid,
    BidsClosed,
    CycleClosed,
    Estimate,
    Grant,
    Measured,
    NodeMessage,
    ShareHeard,
    ShareSent,
)
from concord.nodes.node_state import Phase
from concord.scenarios.build import build_environment, build_node
from tests.experiments.support import small


def heartbeats(setup) -> list[Measured]:
    config = build_environment(setup)
    _, messages = environment.step(config, environment.begin(config), Allowed(1))
    return [message for message in messages if isinstance(message, Measured)]


def estimates(timed: bool, reverse: bool) -> list[Estimate]:
    """One step of four nodes, by hand: whatever was sent is heard, then every cycle is closed."""
    setup = small(steps=1)
    configs = [dataclasses.replace(build_node(setup, node), timed=timed) for node in range(4)]
    states = [state_machine.initial_state(config) for config in configs]
    sent: list[NodeMessage] = []

    def give(node: int, event) -> None:
        states[node], messages = state_machine.step(configs[node], states[node], event)
        sent.extend(messages)

    for node, heartbeat in enumerate(heartbeats(setup)):
        give(node, heartbeat)
    for cycle in range(setup.scenario.rounds):
        due = [one for one in sent if isinstance(one, ShareSent) and one.cycle == cycle]
        for share in reversed(due) if reverse else due:
            for node in range(4):
                if share.node in configs[node].neighbours:
                    give(node, ShareHeard(share.node, share.frame))
        if timed:
            # All messages have arrived, and no node goes on before the deadline.
            assert all(state.cycle == cycle for state in states)
            for node in range(4):
                give(node, CycleClosed(cycle))
    assert all(state.phase is Phase.FINISHED for state in states)
    said = [one for one in sent if isinstance(one, Estimate)]
    return sorted(said, key=lambda one: one.node)


def test_the_clock_changes_nothing_where_all_comes_in_time():
    assert estimates(timed=True, reverse=True) == estimates(timed=False, reverse=False)
    assert all(one.counters.get("missed", 0) == 0 for one in estimates(timed=True, reverse=True))


def test_who_asks_after_the_end_of_bids_is_not_granted_and_is_named():
    config = build_environment(small(schedule="hybrid", occupancy=0.5, steps=2))
    state, _ = environment.step(config, environment.begin(config), Allowed(1))
    cycle, group = state.next_cycle, state.next_group
    first, *late = config.schedule.contenders(cycle)
    assert late
    state, messages = environment.step(config, state, Bid(first, cycle, 1, 30, group))
    assert messages == []
    state, messages = environment.step(config, state, BidsClosed(cycle, group))
    (grant,) = messages
    assert isinstance(grant, Grant)
    assert (grant.cycle, grant.winners, grant.group, grant.unheard) == (cycle, [first], group, late)
    # However urgent: that contest is over, and the next one hears all of them.
    for node in late:
        state, messages = environment.step(config, state, Bid(node, cycle, 9, 30, group))
        assert messages == []
    following = state.next_cycle, state.next_group
    assert following > (cycle, group)
    for node in config.schedule.contenders(following[0]):
        bid = Bid(node, following[0], 1, 30, following[1])
        state, messages = environment.step(config, state, bid)
    assert [grant.unheard for grant in messages if isinstance(grant, Grant)] == [UNSET]
