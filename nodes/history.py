"""History of a network in a run: which nodes took part in which step, and each cycle's step.

It is read from the events of a recording.
"""

from collections.abc import Container, Iterable
from typing import NamedTuple

from nodes.changes import Event, Gone, Joined, Left, Pace, Set


class Epoch(NamedTuple):
    """Steps from `first_step` on have so many rounds; their cycles begin at `first_cycle`."""

    first_step: int
    first_cycle: int
    rounds: int


class Absence(NamedTuple):
    """A node took no part from `first_step` to before `end_step`; None is to the end."""

    node: int
    first_step: int
    end_step: int | None


class History(NamedTuple):
    """The epochs of a run in order, the absent nodes, and whether anything changed at all."""

    epochs: tuple[Epoch, ...]
    absences: tuple[Absence, ...] = ()
    changed: bool = False

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
        return not any(
            absence.node == node
            and absence.first_step <= step
            and (absence.end_step is None or step < absence.end_step)
            for absence in self.absences
        )

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
    if not isinstance(event.change, Pace):
        history = history._replace(changed=True)
    match event.change:
        case Set(settings, first_cycle):
            rounds = int(settings.get("rounds", history.epochs[-1].rounds))
            return history._replace(epochs=(*history.epochs, Epoch(step, first_cycle, rounds)))
        case Left(node) | Gone(node):
            return history._replace(absences=(*history.absences, Absence(node, step, None)))
        case Joined(node):
            absences = tuple(
                absence._replace(end_step=step)
                if absence.node == node and absence.end_step is None
                else absence
                for absence in history.absences
            )
            return history._replace(absences=absences)
    return history


def with_holes(history: History, said: Container[tuple[int, int]], last: dict[int, int]) -> History:
    """The history in which a node takes no part in a step of which the recording has lost what it
    said, though it has something later: in real time what is late is lost. `last` is the latest
    step of each node, `said` every (step, node)."""
    holes = tuple(
        Absence(node, step, step + 1)
        for node, latest in last.items()
        for step in range(latest)
        if (step, node) not in said and history.is_in(node, step)
    )
    return history._replace(absences=history.absences + holes)


def without_lost_words(history: History, estimated: Container[tuple[int, int]]) -> History:
    """Return the history in which a node that died silently is out from its first lost estimate on.

    The recording has lost the estimates from that (step, node) on, though the environment had
    received them.
    """
    absences = []
    for absence in history.absences:
        first = absence.first_step
        while first > 0 and history.is_in(absence.node, first - 1):
            if (first - 1, absence.node) in estimated:
                break
            first -= 1
        absences.append(absence._replace(first_step=first))
    return history._replace(absences=tuple(absences))
