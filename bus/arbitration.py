"""Arbitration: choose the winners of the slots for which nodes contend in a cycle.

An arbiter says how urgent each request is; the bus awards its slots in that order. Both work on any
number of runs at once: a bus that serves messages is a batch of shape `()`.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.int64]

NO_BID = -1
"""In the place of a bid: the node does not ask."""


class ArbiterState(NamedTuple):
    """State that an arbiter may remember, of any number of runs.

    Attributes:
        last_frame_id: (...,), of the slot awarded last; 0 before the first.
        waits: (..., N), contested parts of cycles in a row in which a node asked in vain.
    """

    last_frame_id: Numbers
    waits: Numbers


Urgency = Callable[[ArbiterState, Numbers, Numbers], NDArray[np.generic]]
"""(state, bids (..., C), frame IDs (..., C)) -> order of the requests (..., C), small numbers
first; equal ones go by frame ID. The state is that of the contenders: (..., 1) and (..., C)."""


LastContest = Callable[[int, int | None], int | None]
"""(T, A) -> the contest in which the last one of contenders that fill T contests wins, counted from
the first in which it asks; None for never. A contender that asked in vain A times goes first."""


def never(turns: int, old_after: int | None) -> None:
    """Promise nothing: others may always be served first."""


def by_turn(turns: int, old_after: int | None) -> int:
    """Promise that no contender is served twice while another one asks."""
    return turns


def by_age(turns: int, old_after: int | None) -> int | None:
    """Promise that age decides in the end (`bus/longest_wait.py` has the proof)."""
    if old_after is None or old_after < turns - 1:
        return None
    return old_after + turns - 1


class Arbiter(NamedTuple):
    """How requests are ordered, and what happens to one that does not fit beside the others.

    Attributes:
        urgency: order of the requests.
        overtakes: pass over a request that does not fit; otherwise it ends the cycle, unless it
            would not fit on an empty bus either.
        by_class: a node sends in the frame ID of its urgency class (`bus/arbitration.py`), and
            not in the only one that it has.
        withdraws: hosts count the shares of a cycle and withdraw their requests when as many were
            sent as the schedule lets into it; otherwise the bus sends whatever fits.
        cuts: hosts leave a share of several frames in their buffers that does not fit whole: the
            bus sends its first frames.
        is_ideal: no controller awards slots in this order; a run says so.
        last_contest: how long a contender waits at most.
    """

    urgency: Urgency
    overtakes: bool = True
    by_class: bool = False
    withdraws: bool = True
    cuts: bool = False
    is_ideal: bool = True
    last_contest: LastContest = never


LosingBids = Callable[[Numbers], Numbers]
"""Bids of winners (...) -> the largest bids that losers may have had."""


def unclassed(bids: Numbers) -> Numbers:
    """Return the bids: where the largest one wins, no loser's is larger."""
    return bids


def lowest_frame_id(state: ArbiterState, bids: Numbers, frame_ids: Numbers) -> Numbers:
    """Serve low frame IDs first, as minislots do; high ones can starve."""
    return frame_ids


def largest_bid(state: ArbiterState, bids: Numbers, frame_ids: Numbers) -> Numbers:
    """Serve the largest bids first: weighted try-once-discard."""
    return -bids


def in_turn(state: ArbiterState, bids: Numbers, frame_ids: Numbers) -> NDArray[np.bool_]:
    """Serve by frame ID, from the one after the last that was served."""
    return frame_ids <= state.last_frame_id


ARBITERS: dict[str, Arbiter] = {
    "urgency": Arbiter(lowest_frame_id, by_class=True, is_ideal=False, last_contest=by_age),
    "wtod": Arbiter(largest_bid),
    "minislot": Arbiter(lowest_frame_id, withdraws=False, is_ideal=False),
    "round-robin": Arbiter(in_turn, overtakes=False, last_contest=by_turn),
}

Fits = Callable[[tuple[int, ...], Sequence[int]], bool]
"""(run, places of contenders) -> whether the requests of these contenders fit into one cycle."""


def begin_arbitration(nodes: int, runs: tuple[int, ...] = ()) -> ArbiterState:
    """Return the state before the first cycle."""
    return ArbiterState(np.zeros(runs, dtype=np.int64), np.zeros((*runs, nodes), dtype=np.int64))


def award(
    arbiter: Arbiter,
    state: ArbiterState,
    nodes: Sequence[int] | Numbers,
    frame_ids: Numbers,
    bids: Numbers,
    slots: int,
    fits: Fits | None = None,
    passed: NDArray[np.bool_] | None = None,
) -> tuple[ArbiterState, NDArray[np.bool_]]:
    """Award the slots of one group of a cycle.

    Args:
        arbiter: orders the requests.
        state: what it remembers.
        nodes: (C,), the contenders.
        frame_ids: (C,) or (..., C), of their slots.
        bids: (..., C), `NO_BID` of a contender that does not ask.
        slots: at most this many contenders win.
        fits: whether requests fit beside each other; None where any `slots` of them do.
        passed: (..., C), contenders whose slots are over in this cycle; None for none.

    Returns:
        The state after the cycle, and the winners (..., C).
    """
    nodes = np.asarray(nodes, dtype=np.int64)
    asks, waited = bids != NO_BID, state.waits[..., nodes]
    pending = asks if passed is None else asks & ~passed
    seen = ArbiterState(state.last_frame_id[..., None], waited)
    frame_ids = np.broadcast_to(frame_ids, bids.shape)
    urgency = np.broadcast_to(arbiter.urgency(seen, bids, frame_ids), bids.shape)
    order = np.lexsort((frame_ids, urgency, ~pending), axis=-1)
    if fits is None:
        first = np.arange(bids.shape[-1]) < slots
        ranked = first & np.take_along_axis(pending, order, axis=-1)
    else:
        ranked = np.zeros(bids.shape, dtype=bool)
        for run in np.ndindex(bids.shape[:-1]):
            places = order[run][: np.count_nonzero(pending[run])].tolist()
            ranked[run][_fitting(arbiter, run, places, slots, fits)] = True
    wins = np.zeros(bids.shape, dtype=bool)
    np.put_along_axis(wins, order, ranked, axis=-1)
    ordered_ids = np.take_along_axis(frame_ids, order, axis=-1)
    return _remembered(state, nodes, ordered_ids, ranked, asks, wins), wins


def _fitting(
    arbiter: Arbiter, run: tuple[int, ...], places: Sequence[int], slots: int, fits: Fits
) -> list[int]:
    """Return the ranks of the winners among the `places` that ask, the most urgent first."""
    winners: list[int] = []
    ranks: list[int] = []
    for rank, place in enumerate(places):
        if len(winners) == slots:
            break
        if fits(run, [*winners, place]):
            winners.append(place)
            ranks.append(rank)
        elif not arbiter.overtakes and fits(run, [place]):
            break
    return ranks


def _remembered(
    state: ArbiterState,
    nodes: Numbers,
    ordered_ids: Numbers,
    ranked: NDArray[np.bool_],
    asks: NDArray[np.bool_],
    wins: NDArray[np.bool_],
) -> ArbiterState:
    """Return the state after a cycle; a run in which no contender asked keeps its state."""
    if not len(nodes):
        return state
    # The last winner in the arbiter's order: the first one from behind.
    place = ranked.shape[-1] - 1 - np.argmax(ranked[..., ::-1], axis=-1)
    latest = np.take_along_axis(ordered_ids, place[..., None], axis=-1)[..., 0]
    last_frame_id = np.where(ranked.any(axis=-1), latest, state.last_frame_id)
    waits = np.zeros_like(state.waits)
    waits[..., nodes] = np.where(asks & ~wins, state.waits[..., nodes] + 1, 0)
    contested = asks.any(axis=-1, keepdims=True)
    return ArbiterState(last_frame_id, np.where(contested, waits, state.waits))


class UrgencyClasses:
    """Classes 0 (first on the bus) to `count` - 1 of bids between `least_bid` and `most_bid`.

    Bids have the classes from 1 on, at equal ratios of bids. Class 0 is for contenders that have
    asked in vain `old_after` times in a row, whatever they bid. A winner leaves class 0 for as
    long as that, which bounds the wait of all others (`bus/longest_wait.py`). With `count` 1 a node
    has one frame ID, bids do not matter, and no node grows old.

    Raises:
        ValueError: no class, or an empty range of bids.
    """

    def __init__(
        self, count: int = 1, least_bid: int = 1 << 20, most_bid: int = 1 << 51, old_after: int = 1
    ) -> None:
        if count < 1 or not 0 < least_bid < most_bid or old_after < 1:
            raise ValueError(
                f"{count} urgency classes of bids from {least_bid} to {most_bid}, old after "
                f"{old_after} waits: give at least one class, bids rising from above 0, and an age"
            )
        self.count = count
        self.old_after = old_after if count > 1 else None
        self._least_bid, self._ratio = least_bid, most_bid / least_bid
        self._borders = self.spread(np.arange(1, count - 1) / max(1, count - 1))

    def of(self, bids: Numbers, waits: Numbers) -> NDArray[np.int64]:
        """Return the class of each bid (...) of a contender that asked in vain `waits` (...) times
        in a row."""
        if self.old_after is None:
            return np.zeros(bids.shape, dtype=np.int64)
        classes = self.count - 1 - np.searchsorted(self._borders, bids, side="right")
        return np.where(waits >= self.old_after, 0, classes)

    def spread(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the bids at these places of the range on a logarithmic scale: 0 is its beginning,
        1 and what is beyond its end."""
        return np.rint(self._least_bid * self._ratio ** np.minimum(places, 1.0)).astype(np.int64)


ONE_CLASS = UrgencyClasses()
