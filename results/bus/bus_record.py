"""The bus in the recording of a run: frames, requests and grants, message by message."""

import numpy as np

from concord.bus.bus import Fragment
from concord.nodes.history import History
from concord.nodes.messages import Bid, Grant


class BusRecord:
    """Frames that the nodes of a network sent, and the slots that they asked for and got.

    Lists of counts have a cycle, a node and a number each.
    """

    def __init__(self, nodes: int) -> None:
        self._nodes = nodes
        self._fragments: list[tuple[int, Fragment]] = []
        self._payload_bytes: list[tuple[int, int, int]] = []
        self._asked: list[tuple[int, int, int]] = []
        self._classes: list[tuple[int, int, int]] = []
        self._cut: list[tuple[int, int, int]] = []

    def note_frame(self, node: int, fragment: Fragment, payload_bytes: int) -> None:
        """Note a frame that a node sent."""
        self._fragments.append((node, fragment))
        self._payload_bytes.append((fragment.cycle, node, payload_bytes))

    def note_bid(self, bid: Bid) -> None:
        """Note that a node asked for a slot, if it did."""
        if bid.bid is not None:
            self._asked.append((bid.cycle, bid.node, 1))

    def note_grant(self, grant: Grant) -> None:
        """Note which nodes got slots, and which only for the first frames of a share."""
        won = [(node, grant.urgency_class(node)) for node in grant.winners]
        cut = [(share.node, share.urgency_class) for share in grant.cut_shares.values()]
        known = range(self._nodes)
        self._classes += [(grant.cycle, *one) for one in won + cut if one[0] in known]
        self._cut += [(grant.cycle, node, 1) for node, _ in cut if node in known]

    def whole_shares(self) -> list[tuple[int, Fragment]]:
        """Return the frames of shares that were not cut, by their nodes."""
        cut = {(cycle, node) for cycle, node, _ in self._cut}
        return [(node, part) for node, part in self._fragments if (part.cycle, node) not in cut]

    def payload_bytes(self, history: History, steps: int) -> np.ndarray:
        """Return the bytes of each node in complete steps, (steps, rounds, N)."""
        return self._summed(self._payload_bytes, history, steps)

    def classes(self, history: History, steps: int) -> np.ndarray:
        """Return the urgency class in which each node sent, (steps, rounds, N)."""
        return self._summed(self._classes, history, steps)

    def cut(self, history: History, steps: int) -> np.ndarray:
        """Return whose shares were cut in complete steps, (steps, rounds, N)."""
        return self._summed(self._cut, history, steps) > 0

    def asked(self, history: History, steps: int) -> np.ndarray:
        """Return which node asked for a slot in complete steps, (steps, rounds, N)."""
        return self._summed(self._asked, history, steps) > 0

    def _summed(
        self, counted: list[tuple[int, int, int]], history: History, steps: int
    ) -> np.ndarray:
        total = np.zeros((steps, history.rounds, self._nodes), dtype=np.int64)
        for cycle, node, count in counted:
            step, place = history.place(cycle)
            if step < steps:
                total[step, place, node] += count
        return total
