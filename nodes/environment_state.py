"""The configuration of the environment, and its state between two events."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.bus.arbitration import ArbiterState
from concord.bus.bus import Bus
from concord.bus.schedule import Schedule
from concord.nodes.changes import Change, Standing
from concord.nodes.faults.active import HEALTHY, Faults
from concord.nodes.messages import Bid, Estimate


class EnvironmentPhase(Enum):
    """The events that the environment waits for.

    HELD: no step is under way, and the run controller allows no further one. BIDS: contenders of
    the next contest have not bid, so the network cannot go on. ESTIMATES: all grants of the steps
    under way are out. FINISHED: all members have estimated the last step.
    """

    HELD = "held"
    BIDS = "bids"
    ESTIMATES = "estimates"
    FINISHED = "finished"


class NoiseDraws(Protocol):
    """The randomness of one run: process (steps, q) and measurement (steps, ...), for `Plant`."""

    @property
    def process(self) -> np.ndarray: ...

    @property
    def measurement(self) -> np.ndarray: ...


class Plant(Protocol):
    """The truth and what its sensors deliver."""

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """The state (..., n) at `step + 1` from the state at `step`."""
        ...

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Read the sensors: (..., nodes, readings, d), NaN where a node sees nothing."""
        ...


class ControlStep(NamedTuple):
    """A law that drives the plant: `law(state (n,), memory, step) -> (control (p,), memory)`.

    It sees the estimate of `node`; None lets it see the true state.
    """

    law: Callable[[np.ndarray, Any, int], tuple[np.ndarray, Any]]
    memory: Any
    node: int | None


class Delivery(NamedTuple):
    """A path between sensors and their nodes, such as a measurement bus at each node.

    `transmit(memory, readings (nodes, r, d), step) -> (memory, delivered (nodes, r, d))`.
    """

    transmit: Callable[[Any, np.ndarray, int], tuple[Any, np.ndarray]]
    memory: Any


def _exact(readings: np.ndarray) -> np.ndarray:
    return np.zeros_like(readings)


@dataclass(frozen=True)
class EnvironmentConfig:
    """Everything the environment knows before the start.

    `bus` says who may send when and awards slots; `neighbours` are whom each node hears; `faults`
    decide what is wrong; `spread` gives the standard deviations (nodes, r, d) of readings of that
    shape. The configuration holds from `first_step` on, whose cycles begin at `first_cycle`;
    `rebuild(standing)` makes the one that goes with other settings.
    """

    plant: Plant
    initial_state: np.ndarray
    draws: NoiseDraws
    nodes: int
    steps: int
    rounds: int
    lead: int
    bus: Bus
    controller: ControlStep | None
    states: int
    delivery: Delivery | None = None
    neighbours: Sequence[Sequence[int]] = ()
    first_step: int = 0
    first_cycle: int = 0
    rebuild: "Callable[[Standing], EnvironmentConfig] | None" = None
    faults: Faults = HEALTHY
    spread: Callable[[np.ndarray], np.ndarray] = _exact

    @property
    def schedule(self) -> Schedule:
        """Return which nodes may send in which cycle."""
        return self.bus.schedule

    def cycle_of(self, step: int) -> int:
        """The first communication cycle of a step that is not before `first_step`."""
        return self.first_cycle + (step - self.first_step) * self.rounds


class EnvironmentState(NamedTuple):
    """The environment between two events.

    `released` steps have been sent, of at most `limit`; `completed` ones estimated by all members,
    which left `latest`; `since` is the first step of who has joined. `announced` changes hold from
    the step that is released next; `delivered` (nodes, r, d) is what the sensors did in the step
    that was released last.
    """

    released: int
    completed: int
    truth: np.ndarray
    memory: Any
    control: np.ndarray | None
    estimates: dict[int, dict[int, Estimate]]
    next_cycle: int
    next_group: int
    won: tuple[int, ...]
    bids: dict[tuple[int, int], dict[int, Bid]]
    arbiter: ArbiterState
    delivery: Any
    limit: int
    latest: dict[int, Estimate]
    standing: Standing
    announced: tuple[Change, ...]
    delivered: np.ndarray | None
    since: dict[int, int]

    @property
    def idle(self) -> bool:
        """Nothing is under way: all members have estimated every step that was released."""
        return self.completed == self.released
