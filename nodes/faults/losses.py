"""Which frames a link loses: decided by counting, not by drawing, so that every driver agrees.

The fate of a frame is a hash of (cycle, sender, receiver, number of the frame in its share) under a
key of the run. Every caller gets the same answer, in any order, for one frame or for arrays of
frames. No state is kept between two calls.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

_MASK = (1 << 64) - 1
_FRACTION_BITS = 53
_SENDER_SHIFT, _RECEIVER_SHIFT = 40, 16

LinkUp = Callable[[Any, Any, Any], Any]


class Outage(msgspec.Struct, frozen=True):
    """A directed link is cut from `first_step` to before `end_step`; None is never healed."""

    sender: int
    receiver: int
    first_step: int
    end_step: int | None = None


class LinkState(NamedTuple):
    """Effect of every link of a run on frames.

    Attributes:
        key: two words of 64 bits that belong to (seed, run).
        loss: probability in [0, 1) that a frame is lost on its way to one receiver.
        losses: of links (sender, receiver) that have another.
        outages: links that are cut for a while. cuts: (sender, receiver) that are cut until further
        notice.
        link_up: (step, sender, receiver) -> whether there is a link at all, for graphs that change;
            takes arrays too. None for a graph that stays.
    """

    key: tuple[int, int] = (0, 0)
    loss: float = 0.0
    losses: Mapping[tuple[int, int], float] = {}
    outages: tuple[Outage, ...] = ()
    cuts: frozenset[tuple[int, int]] = frozenset()
    link_up: LinkUp | None = None

    @property
    def perfect(self) -> bool:
        """Nothing is ever lost."""
        return not (self.loss or self.losses or self.outages or self.cuts or self.link_up)


PERFECT = LinkState()


def hears(
    links: LinkState, step: int, cycle: int, sender: int, receiver: int, frame: int = 0
) -> bool:
    """Whether a frame arrives: number `frame` of the sender's share in `cycle`, which lies in
    `step`."""
    if links.link_up is not None and not links.link_up(step, sender, receiver):
        return False
    if (sender, receiver) in links.cuts:
        return False
    if any(_cut(outage, step, sender, receiver) for outage in links.outages):
        return False
    loss = links.losses.get((sender, receiver), links.loss)
    return not loss or _draw(links.key, cycle, sender, receiver, frame) >= _limit(loss)


def hears_all(
    links: LinkState,
    steps: NDArray[np.integer],
    cycles: NDArray[np.integer],
    senders: NDArray[np.integer],
    receivers: NDArray[np.integer],
    frames: NDArray[np.integer] | int = 0,
) -> NDArray[np.bool_]:
    """The same for arrays of one shape, or of shapes that broadcast."""
    steps, cycles, senders, receivers, numbers = np.broadcast_arrays(
        steps, cycles, senders, receivers, frames
    )
    heard = np.ones(steps.shape, dtype=bool)
    if links.link_up is not None:
        heard &= links.link_up(steps, senders, receivers)
    for outage in links.outages:
        heard &= ~_cut(outage, steps, senders, receivers)
    for sender, receiver in links.cuts:
        heard &= (senders != sender) | (receivers != receiver)
    if not (links.loss or links.losses):
        return heard
    limits = np.full(steps.shape, _limit(links.loss), dtype=np.uint64)
    if links.losses:
        known, own = _sorted_limits(links.losses)
        asked = _code(senders, receivers)
        place = np.minimum(np.searchsorted(known, asked), len(known) - 1)
        limits = np.where(known[place] == asked, own[place], limits)
    words = (number.astype(np.uint64) for number in (cycles, senders, receivers, numbers))
    # Numbers of 64 bits are meant to wrap, of which numpy warns where they are scalars.
    with np.errstate(over="ignore"):
        return heard & (_draw(links.key, *words) >= limits)


def chance(key: tuple[int, int], count: Any, one: Any, other: Any) -> Any:
    """Numbers in [0, 1) that belong to whole numbers of 0 or more and a key, alone or as arrays."""
    words = (np.asarray(number).astype(np.uint64) for number in (count, one, other, 0))
    with np.errstate(over="ignore"):
        return _draw(key, *words).astype(float) / (1 << _FRACTION_BITS)


def fraction(key: tuple[int, int], cycle: int, sender: int, receiver: int, frame: int = 0) -> float:
    """A number in [0, 1) that belongs to plain numbers and a key: 40, 24, 24 and 16 bits of them.

    `chance` for one: frames come one by one.
    """
    return _draw(key, cycle, sender, receiver, frame) / (1 << _FRACTION_BITS)


def _cut(outage: Outage, step: Any, sender: Any, receiver: Any) -> Any:
    """Works on numbers and arrays alike."""
    here = (sender == outage.sender) & (receiver == outage.receiver)
    begun = here & (step >= outage.first_step)
    return begun if outage.end_step is None else begun & (step < outage.end_step)


def _sorted_limits(
    losses: Mapping[tuple[int, int], float],
) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
    """Codes (k,) of links, ascending, and the limits (k,) of their draws."""
    codes = np.array([_code(np.int64(s), np.int64(r)) for s, r in losses], dtype=np.int64)
    limits = np.array([_limit(loss) for loss in losses.values()], dtype=np.uint64)
    order = np.argsort(codes)
    return codes[order], limits[order]


def _code(sender: Any, receiver: Any) -> Any:
    """One number for a directed link, of numbers or arrays."""
    return sender.astype(np.int64) << 32 | receiver.astype(np.int64)


def _limit(loss: float) -> int:
    """Frames whose draw is below this are lost."""
    return int(loss * (1 << _FRACTION_BITS))


def _draw(key: tuple[int, int], cycle: Any, sender: Any, receiver: Any, frame: Any) -> Any:
    """A number below 2**53 that depends on all bits of its arguments, for numbers and arrays."""
    link = sender << _SENDER_SHIFT | receiver << _RECEIVER_SHIFT | frame
    return _mix(_mix(link ^ key[0]) ^ cycle ^ key[1]) >> (64 - _FRACTION_BITS)


def _mix(word: Any) -> Any:
    """The next output of the generator SplitMix64 whose state is `word`.

    Source: Steele, Lea, Flood (2014), Fast splittable pseudorandom number generators, figure 17.
    """
    word = word + 0x9E3779B97F4A7C15 & _MASK
    word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9 & _MASK
    word = (word ^ word >> 27) * 0x94D049BB133111EB & _MASK
    return word ^ word >> 31
