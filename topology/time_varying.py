"""Links that come and go: whether one is up, as a pure function of step and ends.

Every function takes numbers or arrays of them and gives the same answer for both; nothing is kept
between two questions, so any driver may ask for any step at any time. Chance comes in as a
function `draw(step, one, other)` of numbers in [0, 1) that counts instead of keeping a stream.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

LinkProcess = Callable[[Any, Any, Any], Any]
Draw = Callable[[Any, Any, Any], Any]

# Before the first step: from here the state of a Markov link is drawn.
_BEFORE = -1


def bernoulli(failure: float, draw: Draw) -> LinkProcess:
    """Each link is down with probability `failure` in a step, whatever it was before; both
    directions at once, so that what a pair loses it loses evenly and the average stays."""

    def up(step: Any, sender: Any, receiver: Any) -> Any:
        return draw(step, *_pair(sender, receiver)) >= failure

    return up


def markov(failure: float, repair: float, draw: Draw) -> LinkProcess:
    """Each link is a chain (Gilbert 1960): an up link fails in a step with probability `failure`,
    a down one comes back with `repair`; both directions at once, in equilibrium from the start.

    A draw below `failure` sends a link down and one of 1 - `repair` or more sends it up, whatever
    it was (`failure` + `repair` <= 1); the others leave it. So its state is that of the last step
    whose draw decided, and is found by looking back from any step: 1 / (failure + repair) steps on
    average.
    """

    def up(step: Any, sender: Any, receiver: Any) -> Any:
        steps, ones, others = np.broadcast_arrays(step, *_pair(sender, receiver))
        state = np.zeros(steps.shape, dtype=bool)
        back = steps.astype(np.int64).copy()
        open_ = np.ones(steps.shape, dtype=bool)
        while open_.any():
            drawn = draw(back[open_], ones[open_], others[open_])
            first = back[open_] == _BEFORE
            goes_up = np.where(first, drawn < repair / (failure + repair), drawn >= 1 - repair)
            decided = first | goes_up | (drawn < failure)
            where = np.flatnonzero(open_)
            state.reshape(-1)[where] = goes_up
            open_.reshape(-1)[where[decided]] = False
            back[open_] -= 1
        return state if state.shape else bool(state)

    return up


def switching(graphs: Sequence[Sequence[Sequence[int]]], every: int) -> LinkProcess:
    """One graph after another, for `every` steps each, and round again.

    Args:
        graphs: whom each node hears, per graph.
    """
    nodes = len(graphs[0])
    codes = [
        np.sort([i * nodes + j for i, heard in enumerate(graph) for j in heard] or [-1])
        for graph in graphs
    ]

    def up(step: Any, sender: Any, receiver: Any) -> Any:
        asked = np.asarray(receiver) * nodes + sender
        phase = np.asarray(step) // every % len(codes)
        found = np.zeros(np.broadcast_shapes(asked.shape, phase.shape), dtype=bool)
        for number, known in enumerate(codes):
            place = np.minimum(np.searchsorted(known, asked), len(known) - 1)
            found |= (phase == number) & (known[place] == asked)
        return found if found.shape else bool(found)

    return up


def in_range(positions: NDArray[np.float64], reach: float) -> LinkProcess:
    """Return links between nodes at `positions` (steps, n, 2) up to the distance `reach`."""

    def up(step: Any, sender: Any, receiver: Any) -> Any:
        offset = positions[step, sender] - positions[step, receiver]
        return (offset * offset).sum(axis=-1) <= reach * reach

    return up


def wandering(
    homes: NDArray[np.float64], radius: float, period: float, steps: int, draw: Draw
) -> NDArray[np.float64]:
    """Positions (steps, n, 2) of nodes that circle around their homes (n, 2) with that radius and
    period in steps, each from a place and in a sense of its own."""
    node = np.arange(len(homes))
    begin = 2 * math.pi * draw(_BEFORE, node, node)
    sense = np.where(draw(_BEFORE - 1, node, node) < 0.5, 1.0, -1.0)
    angle = begin + sense * (2 * math.pi / period) * np.arange(steps)[:, None]
    return homes + radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)


def _pair(one: Any, other: Any) -> tuple[Any, Any]:
    return np.minimum(one, other), np.maximum(one, other)
