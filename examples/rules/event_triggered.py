"""Event-triggered covariance intersection: a node sends when its belief has moved far enough.

The change is measured in units of the own covariance; in between, all that heard the last share
predict it. Bits are saved where nodes contend for their slots, so a schedule with contention is
needed; static slots are filled in any case. Source: Alanwar, Said, Mehta and Althoff (2020),
Event-triggered diffusion Kalman filters, ICCPS, pages 206 to 215.

    concord run --scenario oscillator --rule examples/rules/event_triggered.py:EVENTS \
        --schedule dynamic --occupancy 1
"""

from concord.filters.fusion.averaging import INFORMATION
from concord.nodes.rules.belief_consensus import BeliefConsensus
from concord.scenarios.node_context import RuleContext
from concord.scenarios.rule_table.rule import BELIEFS, once

CHANGE = 1.0
"""Squared change of the mean, in own variances, from which on a node asks for a slot."""


def built(context: RuleContext) -> BeliefConsensus:
    """Covariance intersection whose nodes ask for a slot after a change alone."""
    trigger = max(CHANGE, context.trigger)
    asks = trigger, context.contends, context.angles
    return BeliefConsensus(INFORMATION, context.hold, context.states, *asks)


EVENTS = once(BELIEFS, built)
