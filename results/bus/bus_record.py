"""The bus in the recording of a run: frames, requests and grants, message by message."""

from array import array
from hashlib import blake2b

import numpy as np

from concord.bus.bus import Fragment
from concord.nodes.history import History
from concord.nodes.messages import Bid, Grant

# Rows are looked through for repeats when so many numbers are kept.
_FIRST_LIMIT = 1 << 18


class _Rows:
    """Rows of whole numbers; one that came twice counts once."""

    def __init__(self, width: int) -> None:
        self._width, self._numbers, self._limit = width, array("q"), _FIRST_LIMIT

    def add(self, *row: int) -> None:
        """Keep a row."""
        self._numbers.extend(row)
        if len(self._numbers) > self._limit:
            self._numbers = array("q", self.once().tobytes())
            self._limit = max(_FIRST_LIMIT, 2 * len(self._numbers))

    def once(self) -> np.ndarray:
        """Return the different rows in ascending order, (rows, width)."""
        rows = np.frombuffer(self._numbers, dtype=np.int64).reshape(-1, self._width)
        return np.unique(rows, axis=0)


class BusRecord:
    """Frames that the nodes of a network sent, and the slots that they asked for and got.

    Rows have a cycle, a node and a number; those of bytes also one that tells frames apart.
    """

    def __init__(self, nodes: int, keeps_shares: bool) -> None:
        """Args:
        nodes: number of nodes.
        keeps_shares: whether the contents of frames are kept too, for `whole_shares`.
        """
        self._nodes, self._keeps_shares = nodes, keeps_shares
        self._fragments: list[tuple[int, Fragment]] = []
        self._payload_bytes = _Rows(4)
        self._asked, self._classes, self._cut = (_Rows(3) for _ in range(3))

    def note_frame(self, node: int, fragment: Fragment, payload_bytes: int) -> None:
        """Note a frame that a node sent."""
        if self._keeps_shares:
            self._fragments.append((node, fragment))
        self._payload_bytes.add(fragment.cycle, node, payload_bytes, _digest(fragment))

    def note_bid(self, bid: Bid) -> None:
        """Note that a node asked for a slot, if it did."""
        if bid.bid is not None:
            self._asked.add(bid.cycle, bid.node, 1)

    def note_grant(self, grant: Grant) -> None:
        """Note which nodes got slots, and which only for the first frames of a share."""
        won = [(node, grant.urgency_class(node)) for node in grant.winners]
        cut = [(share.node, share.urgency_class) for share in grant.cut_shares.values()]
        for node, urgency_class in won + cut:
            if node < self._nodes:
                self._classes.add(grant.cycle, node, urgency_class)
        for node, _ in cut:
            if node < self._nodes:
                self._cut.add(grant.cycle, node, 1)

    def whole_shares(self) -> list[tuple[int, Fragment]]:
        """Return the frames of shares that were not cut, by their nodes."""
        cut = {(cycle, node) for cycle, node, _ in self._cut.once().tolist()}
        frames = dict.fromkeys(self._fragments)
        return [(node, part) for node, part in frames if (part.cycle, node) not in cut]

    def payload_bytes(self, history: History, steps: int) -> np.ndarray:
        """Return the bytes of each node in complete steps, (steps, rounds, N)."""
        total = np.zeros((steps, history.rounds, self._nodes), dtype=np.int64)
        places, payload_bytes = _placed(self._payload_bytes.once(), history, steps)
        np.add.at(total, places, payload_bytes)
        return total

    def classes(self, history: History, steps: int) -> np.ndarray:
        """Return the urgency class in which each node sent, (steps, rounds, N)."""
        return self._said(self._classes, history, steps)

    def cut(self, history: History, steps: int) -> np.ndarray:
        """Return whose shares were cut in complete steps, (steps, rounds, N)."""
        return self._said(self._cut, history, steps) > 0

    def asked(self, history: History, steps: int) -> np.ndarray:
        """Return which node asked for a slot in complete steps, (steps, rounds, N)."""
        return self._said(self._asked, history, steps) > 0

    def _said(self, rows: _Rows, history: History, steps: int) -> np.ndarray:
        found = np.zeros((steps, history.rounds, self._nodes), dtype=np.int64)
        places, numbers = _placed(rows.once(), history, steps)
        found[places] = numbers
        return found


def _digest(fragment: Fragment) -> int:
    """Return eight bytes that tell the frames of a node in a cycle apart."""
    said = fragment.frame_id.to_bytes(8) + fragment.data
    return int.from_bytes(blake2b(said, digest_size=8).digest(), signed=True)


def _placed(
    counts: np.ndarray, history: History, steps: int
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Return steps, rounds and nodes of the counts in complete steps, and their numbers."""
    cycles, which = np.unique(counts[:, 0], return_inverse=True)
    places = np.array([history.place(one) for one in cycles.tolist()], dtype=np.int64)
    step, place = places.reshape(-1, 2)[which].T
    known = step < steps
    return (step[known], place[known], counts[known, 1]), counts[known, 2]
