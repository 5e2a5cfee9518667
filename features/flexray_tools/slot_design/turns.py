"""Turns of nodes in static slots that make a cost least: in which cycles each node sends."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product
from typing import NamedTuple

from concord.features.flexray_tools.slot_design.demand import DemandError

# All turns are tried while there are at most so many combinations.
_MOST_TRIED = 20_000
# A change counts as better from this part of the cost on.
_BETTER = 1e-9


class CycleTurn(NamedTuple):
    """A node sends in the cycles with cycle % repetition == base_cycle."""

    base_cycle: int
    repetition: int

    def sends(self, cycle: int) -> bool:
        """Whether the turn is in a cycle."""
        return cycle % self.repetition == self.base_cycle


class TurnDesign(NamedTuple):
    """The turn of each node, their cost, and whether no turns have less."""

    turns: tuple[CycleTurn, ...]
    cost: float
    exact: bool


TurnCost = Callable[[Sequence[CycleTurn]], float]


def equal_turns(nodes: int, places: int, longest: int) -> tuple[CycleTurn, ...]:
    """Return turns of equal length, the shortest that fit into so many places of a cycle.

    Raises:
        DemandError: even the longest turns do not fit.
    """
    repetition = 1
    while nodes > places * repetition:
        repetition *= 2
    if repetition > longest:
        raise DemandError(
            f"{nodes} nodes with at most {places} shares in a cycle take turns of {repetition} "
            f"cycles, but the longest turn is {longest}; allow more slots or longer turns"
        )
    return tuple(CycleTurn(node % repetition, repetition) for node in range(nodes))


def best_turns(nodes: int, places: int, longest: int, cost: TurnCost) -> TurnDesign:
    """Return the turns of least cost in which at most `places` nodes send in a cycle.

    Repetitions are powers of two up to `longest`. Where there are too many combinations to try
    all, the turns are the best to which no change of one node and no exchange of two leads.

    Raises:
        DemandError: no turns fit.
    """
    begun = equal_turns(nodes, places, longest)
    every = [CycleTurn(base, 1 << k) for k in range(longest.bit_length()) for base in range(1 << k)]
    if len(every) ** nodes <= _MOST_TRIED:
        tried = (turns for turns in product(every, repeat=nodes) if _fits(turns, places, longest))
        best = min((cost(turns), turns) for turns in tried)
        return TurnDesign(best[1], best[0], True)
    turns, least = begun, cost(begun)
    while True:
        before = least
        for changed in _changes(turns, every):
            if not _fits(changed, places, longest):
                continue
            found = cost(changed)
            if found < least * (1 - _BETTER):
                turns, least = changed, found
        if least == before:
            return TurnDesign(turns, least, False)


def places_of_turns(turns: Sequence[CycleTurn]) -> tuple[int, ...]:
    """Return the place in the cycle of each node: the first that is free in all its cycles."""
    taken: dict[int, list[CycleTurn]] = {}
    found: dict[int, int] = {}
    for node in sorted(range(len(turns)), key=lambda one: (turns[one].repetition, one)):
        place = 0
        while any(_meet(turns[node], other) for other in taken.get(place, ())):
            place += 1
        taken.setdefault(place, []).append(turns[node])
        found[node] = place
    return tuple(found[node] for node in range(len(turns)))


def _changes(
    turns: tuple[CycleTurn, ...], every: Sequence[CycleTurn]
) -> Iterator[tuple[CycleTurn, ...]]:
    for node in range(len(turns)):
        for turn in every:
            if turn != turns[node]:
                yield (*turns[:node], turn, *turns[node + 1 :])
    for one, other in combinations(range(len(turns)), 2):
        if turns[one] != turns[other]:
            swapped = list(turns)
            swapped[one], swapped[other] = swapped[other], swapped[one]
            yield tuple(swapped)


def _fits(turns: Sequence[CycleTurn], places: int, longest: int) -> bool:
    sent = Counter(
        cycle for turn in turns for cycle in range(turn.base_cycle, longest, turn.repetition)
    )
    return max(sent.values()) <= places


def _meet(one: CycleTurn, other: CycleTurn) -> bool:
    shorter = min(one.repetition, other.repetition)
    return one.base_cycle % shorter == other.base_cycle % shorter
