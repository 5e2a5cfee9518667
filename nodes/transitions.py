"""The table of a state machine as data: the handler of each event in each phase, and its end.

The node (`nodes/node.py`) and the environment (`nodes/environment.py`) each have one table. Their
`step` looks up every event in it, so a state diagram that is drawn from the table is true.
"""

from collections.abc import Callable
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

State = TypeVar("State")
PhaseT = TypeVar("PhaseT", bound=Enum)


class Transition(NamedTuple, Generic[State, PhaseT]):
    """An event in a phase: `handle(config, state, event, outbox)` returns the next state.

    The next state is in one of the phases `leads_to`.
    """

    handle: Callable[..., State]
    leads_to: tuple[PhaseT, ...]


class Completion(NamedTuple, Generic[State, PhaseT]):
    """A transition without an event of its own: it happens as soon as `is_due(config, state)`.

    `go_on(config, state, outbox)` returns the next state, in one of the phases `leads_to`.
    """

    is_due: Callable[..., bool]
    go_on: Callable[..., State]
    leads_to: tuple[PhaseT, ...]
