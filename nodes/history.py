"""History of a network in a run: which nodes took part in which step, and each cycle's step.

It is read from the events of a recording.
"""

from bisect import bisect_right
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Literal, NamedTuple

import numpy as np

from concord.nodes.changes import Event, Fault, Gone, Joined, Left, PaceChange, Set
from concord.nodes.faults.vocabulary import FAULTS

_DRAWING = ("graph", "placement")
_HINDERING = frozenset(kind for kind, word in FAULTS.items() if word.family == "nodes")


class Epoch(NamedTuple):
    """Steps from `first_step` on have so many rounds; their cycles begin at `first_cycle`.

    `drawn_by` are the settings (name, word) that decide who hears whom and where the nodes are;
    what the scenario says is not among them.
    """

    first_step: int
    first_cycle: int
    rounds: int
    drawn_by: tuple[tuple[str, str], ...] = ()


class AbsentSteps(NamedTuple):
    """A node took no part from `first_step` to before `end_step`; None is to the end.

    `why`: on command or by a fault that was asked for, since its process was gone, or in real time
    since its estimate came late.
    """

    node: int
    first_step: int
    end_step: int | None
    why: Literal["asked", "gone", "late"] = "asked"


@dataclass(frozen=True)
class History:
    """The epochs of a run in order, the absent nodes, and whether anything changed at all.

    `hindered` are the nodes that a fault has made slow or hang, since these may be gone by it.
    """

    epochs: tuple[Epoch, ...]
    absent_steps: tuple[AbsentSteps, ...] = ()
    changed: bool = False
    hindered: frozenset[int] = frozenset()

    @cached_property
    def _out(self) -> dict[int, tuple[list[int], list[float]]]:
        """By node: the steps from which it is out, in order, and how far any up to each reaches."""
        found: dict[int, tuple[list[int], list[float]]] = {}
        for node, first, end, _ in sorted(self.absent_steps, key=lambda one: one.first_step):
            begins, reaches = found.setdefault(node, ([], []))
            begins.append(first)
            reaches.append(max([inf if end is None else end, *reaches[-1:]]))
        return found

    @property
    def one_bus(self) -> bool:
        """Schedule and slots are those of the beginning."""
        return len(self.epochs) == 1

    @property
    def rounds(self) -> int:
        """The most rounds that a step has."""
        ends = (*(epoch.first_step for epoch in self.epochs[1:]), None)
        pairs = zip(self.epochs, ends, strict=True)
        return max(epoch.rounds for epoch, end in pairs if epoch.first_step != end)

    def is_in(self, node: int, step: int) -> bool:
        """Whether a node takes part in a step."""
        begins, reaches = self._out.get(node, ((), ()))
        place = bisect_right(begins, step)
        return place == 0 or reaches[place - 1] <= step

    def presence(self, steps: int, nodes: int) -> np.ndarray:
        """Return which of so many nodes take part in the first steps, (steps, N)."""
        found = np.ones((steps, nodes), dtype=bool)
        for node, first, end, _ in self.absent_steps:
            found[first:end, node] = False
        return found

    def since(self, step: int) -> "History":
        """Return the history without those who were back before a step."""
        lasting = (one for one in self.absent_steps if one.end_step is None or one.end_step > step)
        return replace(self, absent_steps=tuple(lasting))

    def drawn_by(self, step: int) -> tuple[tuple[str, str], ...]:
        """Return the settings of a step as `Epoch` has them."""
        return next(e.drawn_by for e in reversed(self.epochs) if e.first_step <= step)

    @property
    def moves(self) -> list[tuple[int, str]]:
        """From which step on the sensors stood where, as words that were set."""
        told = ((epoch.first_step, dict(epoch.drawn_by)) for epoch in self.epochs)
        return [(step, drawn["placement"]) for step, drawn in told if "placement" in drawn]

    def place(self, cycle: int) -> tuple[int, int]:
        """The step that a communication cycle belongs to, and the number of its round."""
        epoch = next(e for e in reversed(self.epochs) if e.first_cycle <= cycle)
        steps, rounds = divmod(cycle - epoch.first_cycle, epoch.rounds)
        return epoch.first_step + steps, rounds


def history_of(rounds: int, events: Iterable[Event]) -> History:
    """The history of a run that began with so many rounds per step, from its events in order."""
    history = History((Epoch(0, 0, rounds),))
    for event in events:
        history = with_event(history, event)
    return history


def with_event(history: History, event: Event) -> History:
    """The history that goes on with this."""
    step = event.step
    if not isinstance(event.change, PaceChange):
        history = replace(history, changed=True)
    absent = history.absent_steps
    match event.change:
        case Set(settings, first_cycle):
            rounds = int(settings.get("rounds", history.epochs[-1].rounds))
            drawn_by = tuple((name, str(settings[name])) for name in _DRAWING if name in settings)
            epoch = Epoch(step, first_cycle, rounds, drawn_by)
            return replace(history, epochs=(*history.epochs, epoch))
        case Left(node) | Gone(node):
            place = _open(absent, node)
            is_asked = isinstance(event.change, Left) or node in history.hindered
            since = AbsentSteps(node, step, None, "asked" if is_asked else "gone")
            if place is not None:
                since = min(since, absent[place], key=lambda one: one.first_step)
            return replace(history, absent_steps=_with(absent, place, since))
        case Fault(kind, nodes) if kind in _HINDERING:
            return replace(history, hindered=history.hindered | {*nodes})
        case Joined(node) if (place := _open(absent, node)) is not None:
            ended = absent[place]._replace(end_step=step)
            return replace(history, absent_steps=_with(absent, place, ended))
    return history


def _with(
    absent_steps: tuple[AbsentSteps, ...], place: int | None, one: AbsentSteps
) -> tuple[AbsentSteps, ...]:
    """Return the steps of absent nodes with another one at a place; None is after all."""
    if place is None:
        return (*absent_steps, one)
    return (*absent_steps[:place], one, *absent_steps[place + 1 :])


def _open(absent_steps: Sequence[AbsentSteps], node: int) -> int | None:
    """Return the place of a node that is out and has not returned; None if it takes part."""
    for place in range(len(absent_steps) - 1, -1, -1):
        if absent_steps[place].node == node:
            return place if absent_steps[place].end_step is None else None
    return None


def with_holes(
    history: History, recorded: Container[tuple[int, int]], nodes: int, steps: int
) -> History:
    """The history in which a node takes no part in a step of which the recording has nothing of it.

    In real time what is late is lost, and a node that falls behind holds up no other. `recorded` is
    every (step, node), of so many nodes and steps.
    """
    holes = tuple(
        AbsentSteps(node, step, step + 1, "late")
        for node in range(nodes)
        for step in range(steps)
        if (step, node) not in recorded and history.is_in(node, step)
    )
    return replace(history, absent_steps=history.absent_steps + holes)


def without_lost_words(history: History, estimated: Container[tuple[int, int]]) -> History:
    """Return the history in which a node that died silently is out from its first lost estimate on.

    The recording has lost the estimates from that (step, node) on, though the environment had
    received them.
    """
    absent_steps = []
    for absent in history.absent_steps:
        first = absent.first_step
        while first > 0 and history.is_in(absent.node, first - 1):
            if (first - 1, absent.node) in estimated:
                break
            first -= 1
        absent_steps.append(absent._replace(first_step=first))
    return replace(history, absent_steps=tuple(absent_steps))
