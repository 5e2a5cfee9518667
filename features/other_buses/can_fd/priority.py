"""Identifiers from bids: the urgency of a share in the upper bits, the node in the lower ones.

The lowest identifier wins the arbitration, so the most urgent share is sent first. Level 0 belongs
to the nodes that own a turn in a cycle; contenders have the levels from 1 on.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Numbers

_MOST_LEVELS = 2047
# Bids beyond this are equally urgent.
_OCTAVES = 52
_LARGEST_BID = 2**53


class Identifiers(NamedTuple):
    """Layout of the identifiers of a network: so many bits for the node, so many for its level."""

    node_bits: int
    level_bits: int

    @property
    def levels(self) -> int:
        """Levels that contenders have."""
        return min(_MOST_LEVELS, (1 << self.level_bits) - 1)

    def of_owner(self, node: int) -> range:
        """Return the identifier of a node that owns a turn."""
        return range(node, node + 1)

    def of_contender(self, node: int, count: int) -> range:
        """Return the identifiers of a node in each of so many classes, the most urgent first."""
        step = 1 << self.node_bits
        return range(step + node, (count + 1) * step, step)


def layout(nodes: int, identifier_bits: int, classes: int) -> Identifiers:
    """Return the layout for so many nodes with so many classes of bids each.

    Raises:
        ValueError: the identifiers are too short.
    """
    node_bits = max(1, (nodes - 1).bit_length())
    found = Identifiers(node_bits, identifier_bits - node_bits)
    if found.level_bits < 0 or found.levels < classes:
        needed = node_bits + classes.bit_length()
        raise ValueError(
            f"--bus can-fd with identifiers of {identifier_bits} bits: {nodes} nodes with "
            f"{classes} classes of urgency need {needed} bits; use --identifiers extended, "
            "fewer --nodes or fewer --urgency-classes"
        )
    return found


class BidLevels:
    """Bids on a logarithmic scale of whole steps: class 0 has the largest bids.

    span: least and largest bid that are told apart, where the bids are logarithms themselves; None
    where they are numbers from 1 to 2^52.

    Raises:
        ValueError: fewer than one class for each doubling of a bid.
    """

    old_after: int | None = None

    def __init__(self, levels: int, span: tuple[int, int] | None = None) -> None:
        steps = (levels - 1) // _OCTAVES
        if steps < 1:
            raise ValueError(
                f"--bus can-fd --arbiter wtod: {levels} levels of urgency are fewer than the "
                f"{_OCTAVES + 1} that tell bids apart; use --identifiers extended or fewer --nodes"
            )
        if span is None:
            self.count = steps * _OCTAVES + 1
            borders = np.exp2(np.arange(1, self.count) / steps)
        else:
            self.count = levels
            borders = np.linspace(*span, levels - 1)
        self._borders = np.rint(borders).astype(np.int64)

    def of(self, bids: Numbers, waits: Numbers) -> NDArray[np.int64]:
        """Return the class of each bid (...)."""
        return self.count - 1 - np.searchsorted(self._borders, bids, side="right")

    def largest(self, bids: Numbers) -> NDArray[np.int64]:
        """Return the largest bid that has the class of each bid (...); -1 of a bid below 0."""
        ends = np.append(self._borders - 1, _LARGEST_BID)
        largest = ends[np.searchsorted(self._borders, bids, side="right")]
        return np.where(np.asarray(bids) < 0, -1, largest)
