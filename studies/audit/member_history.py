"""MemberHistory and cycles of a run, counted from its recorded events."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Any, NamedTuple

_OUT = ("left", "gone")


class Turn(NamedTuple):
    """A node is out of the network, or back in it, from a step on; `told` on command."""

    step: int
    node: int
    is_in: bool
    told: bool = True


class MemberHistory(NamedTuple):
    """Turns of each node in order, and (first step, first cycle, rounds) of each setting.

    `repeated`: turns that found the node where they put it.
    """

    turns: dict[int, list[Turn]]
    epochs: list[tuple[int, int, int]]
    repeated: list[Turn]

    def is_in(self, node: int, step: int) -> bool:
        """Whether the network had told that a node takes part in a step."""
        turns = self.turns.get(node, [])
        last = bisect_right(turns, step, key=_step_of) - 1
        return last < 0 or turns[last].is_in

    def hangs_in(self, node: int, step: int) -> bool:
        """Whether a node is out in a step, and no command said so: it may hang, and speak on until
        it hears that it was given up."""
        turns = self.turns.get(node, [])
        last = bisect_right(turns, step, key=_step_of) - 1
        return last >= 0 and not (turns[last].is_in or turns[last].told)

    def joins_at(self, node: int, step: int) -> bool:
        """Whether a node is back from this step on, for however long."""
        turns = self.turns.get(node, [])
        ends = (bisect(turns, step, key=_step_of) for bisect in (bisect_left, bisect_right))
        return any(turn.is_in for turn in turns[slice(*ends)])

    def dies_in(self, node: int, step: int) -> bool:
        """Whether a node took part in a step from which it is out."""
        began = self.joins_at(node, step) or (step > 0 and self.is_in(node, step - 1))
        return began and not self.is_in(node, step)

    def left_at(self, node: int, step: int) -> int | None:
        """Return the first step after `step` from which a node is out; None for never."""
        turns = self.turns.get(node, [])
        later = turns[bisect_right(turns, step, key=_step_of) :]
        return next((turn.step for turn in later if not turn.is_in), None)

    def step_of(self, cycle: int) -> int:
        """Return the step to which a cycle of rounds belongs."""
        first_step, first_cycle, rounds = self._epoch(cycle, 1)
        return first_step + (cycle - first_cycle) // rounds

    def cycles_of(self, step: int) -> range:
        """Return the cycles of rounds of a step."""
        first_step, first_cycle, rounds = self._epoch(step, 0)
        first = first_cycle + (step - first_step) * rounds
        return range(first, first + rounds)

    def _epoch(self, number: int, place: int) -> tuple[int, int, int]:
        return [epoch for epoch in self.epochs if epoch[place] <= number][-1]


def _step_of(turn: Turn) -> int:
    return turn.step


def member_history_of(rounds: int, events: Sequence[tuple[int, dict[str, Any]]]) -> MemberHistory:
    """Count members and cycles of a run that began with all nodes and so many rounds a step."""
    turns: dict[int, list[Turn]] = {}
    epochs, repeated = [(0, 0, rounds)], []
    for step, change in events:
        if change["what"] == "settings":
            rounds = int(change["settings"].get("rounds", epochs[-1][2]))
            epochs.append((step, change["first_cycle"], rounds))
        elif change["what"] in (*_OUT, "joined"):
            before = turns.setdefault(change["node"], [])
            # In real time a node may be given up from a step that is over, before its last return.
            first = max([step, *(turn.step for turn in before[-1:])])
            turn = Turn(first, change["node"], change["what"] == "joined", change["what"] == "left")
            if (before[-1].is_in if before else True) == turn.is_in:
                repeated.append(turn)
            before.append(turn)
    return MemberHistory(turns, epochs, repeated)
