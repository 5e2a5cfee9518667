"""How a rule is built at all nodes of many runs at once: `scenarios.estimators` in arrays."""

from typing import NamedTuple

import numpy as np

from filters.fusion import Averaging
from nodes.belief_consensus import HoldPolicy
from nodes.vectorised import Fleet
from nodes.vectorised_beliefs import BeliefFleet
from nodes.vectorised_filter import LocalFilters
from nodes.vectorised_links import Links, Shares


class FleetSeat(NamedTuple):
    """All that the array form of a rule is built from.

    `base` are the weights of a run, `contenders` (C,) the nodes that may ask for the dynamic
    segment; `number` is "<f8" or "<f4".
    """

    filters: LocalFilters
    links: Links
    base: Shares
    hold: HoldPolicy
    contenders: np.ndarray
    trigger: float
    number: str


def averaging_fleet(averaging: Averaging | None, seat: FleetSeat) -> Fleet:
    """For rules that average beliefs; None for the rule that does not."""
    return BeliefFleet(
        filters=seat.filters,
        averaging=averaging,
        hold=seat.hold,
        links=seat.links,
        base=seat.base,
        contenders=seat.contenders,
        number=seat.number,
        trigger=seat.trigger,
    )
