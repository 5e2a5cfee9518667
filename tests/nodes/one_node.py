"""One node between two neighbours, what they may send it, and what it makes of that."""

from collections.abc import Sequence

import numpy as np

from concord.bus.schedule import Schedule, dynamic_only, full_publish, hybrid, round_robin
from concord.filters.fusion.averaging import INFORMATION, Averaged
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Estimate, Grant, Measured, NodeEvent, NodeMessage, ShareHeard
from concord.nodes.node import NodeConfig, NodeState, initial_state, step
from concord.nodes.rules.belief_consensus import HoldPolicy
from concord.nodes.vector_codec import BeliefCodec
from tests.nodes.networks import DECAYED, network, path, random_priors

STEPS, ROUNDS = 4, 2
STRANGER = 5
PRIORS = random_priors(np.random.default_rng(0), 3, 2)


def middle_node(
    schedule: Schedule | None = None,
    average: Averaged = INFORMATION,
    hold_policy: HoldPolicy = DECAYED,
) -> NodeConfig:
    """Node 1 of the path 0 - 1 - 2, which sees nothing itself."""
    net = network(
        path(3),
        PRIORS,
        steps=STEPS,
        rounds=ROUNDS,
        process_noise_cov=0.1 * np.eye(2),
        average=average,
        hold_policy=hold_policy,
        schedule=schedule,
    )
    return net.nodes[1]


def share(config: NodeConfig, sender: int, cycle: int, belief: Gaussian | None = None) -> bytes:
    """The frame that a neighbour sends in a cycle."""
    body = BeliefCodec(2).encode(belief or PRIORS[sender])
    return config.bus.encode(sender, cycle, body)[0]


def feed(config: NodeConfig, events: Sequence[NodeEvent]) -> tuple[NodeState, list[NodeMessage]]:
    """Return the state after these events, and the sent messages."""
    state, sent = initial_state(config), []
    for event in events:
        state, messages = step(config, state, event)
        sent += messages
    return state, sent


def heartbeat(number: int) -> Measured:
    return Measured(1, number, [[None, None]])


def clean_events(config: NodeConfig) -> list[NodeEvent]:
    """A run in which everything comes in time."""
    events: list[NodeEvent] = []
    for number in range(STEPS):
        events.append(heartbeat(number))
        for cycle in range(number * ROUNDS, (number + 1) * ROUNDS):
            contenders = config.schedule.contenders(cycle)
            winners = contenders[: config.schedule.dynamic_slots(cycle)]
            if contenders:
                events.append(Grant(cycle, list(winners)))
            events += [
                ShareHeard(j, share(config, j, cycle))
                for j in config.neighbours
                if j in config.schedule.static_senders(cycle) + winners
            ]
    return events


def estimates(messages: list[NodeMessage]) -> list[tuple]:
    """Return the content of the estimates, without the counters."""
    return [(m.step, m.mean, m.cov, m.ages) for m in messages if isinstance(m, Estimate)]


SCHEDULES = {
    "full": full_publish(3),
    "round robin": round_robin(3, 1),
    "hybrid": hybrid(3, 0.7),
    "dynamic": dynamic_only(3, 0.7),
}
