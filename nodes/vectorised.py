"""The vectorised driver: all nodes of many runs as arrays (runs, nodes, ...), step by step.

World, bus and nodes do here what `nodes.world` and `nodes.state_machine` do by messages, with the
same functions: run r has the numbers that the in-process driver gives it to 1e-10. Nothing is a
message, so nothing can be late, repeated or malformed.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from bus.schedule import Schedule
from filters.gaussian import Gaussian
from nodes.bids import NO_BID
from nodes.messages import Array
from nodes.state_machine import contenders_left
from nodes.vectorised_filter import Counters
from nodes.world import Controller, Delivery, Plant

Contest = Callable[[Any, int, int, np.ndarray, np.ndarray], tuple[Any, np.ndarray]]
"""The arbiter of all runs: (memory, cycle, group of it, nodes (C,) that may ask, bids (R, C)) ->
(memory, wins (R, C)); `bids.NO_BID` does not ask."""


class Spread(NamedTuple):
    """What the shares of a step carried, of a rule that passes on records.

    body_bytes, checkpoints, records: (rounds, R, N), of what a node sent in a cycle. held: (R, N,
    W, N) bool, whether a node holds what a source took in each of the last W steps, this one last.
    """

    body_bytes: np.ndarray
    checkpoints: np.ndarray
    records: np.ndarray
    held: np.ndarray


class Fleet(Protocol):
    """A fusion rule at all nodes of all runs: `nodes.estimator.Estimator` in arrays.

    Contents are values that only the fleet reads. Links are those of its network, in its order.
    """

    def start(self, prior: Gaussian) -> Any:
        """The content before the first step, of priors (R, N, n), (R, N, n, n)."""
        ...

    def begin_step(self, content: Any, readings: Array, control: Array | None, step: int) -> Any:
        """Carry everything to `step` under control (R, p); take readings (R, N, r, d)."""
        ...

    def bids(self, content: Any, nodes: np.ndarray) -> np.ndarray:
        """How urgent a dynamic slot is to these nodes (C,): integers (R, C)."""
        ...

    def exchange(self, content: Any, sends: np.ndarray, lost: np.ndarray | None) -> Any:
        """A communication cycle, or with relays a part of one, in which nodes `sends` (R, N) share
        and all fuse.

        `lost` (R, E) counts the frames that each link loses of a share; None where none does.
        """
        ...

    def belief(self, content: Any) -> Gaussian:
        """What the nodes believe now: (R, N, n), (R, N, n, n)."""
        ...

    def ages(self, content: Any) -> np.ndarray:
        """Cycles since what came over each link was sent (R, E); -1 is never."""
        ...

    def counters(self, content: Any) -> Counters:
        """What was counted since the start."""
        ...

    def spread(self, content: Any) -> Spread | None:
        """What the shares of the step carried; None for a rule whose shares have one length."""
        ...


@dataclass(frozen=True)
class Network:
    """Everything about R runs of a network.

    initial_state: (R, n). prior: (R, N, n), (R, N, n, n). process: normals (steps, R, q).
    measurement: (steps, R, N, r, d). lost: cycle -> how many frames of a share each link loses in
    it (R, E); None where no frame is ever lost.
    """

    plant: Plant
    initial_state: Array
    prior: Gaussian
    process: Array
    measurement: Array
    steps: int
    rounds: int
    schedule: Schedule
    contest: Contest
    contest_memory: Any
    controller: Controller | None
    delivery: Delivery | None
    lost: Callable[[int], np.ndarray] | None
    fleet: Fleet


class Instant(NamedTuple):
    """What happened in a step.

    truth: (R, n). readings: (R, N, r, d). control: (R, p) that drove into the step. belief: after
    the last round, (R, N, n), (R, N, n, n). ages: (R, E). sends, asked: (rounds, R, N), who sent in
    a cycle and who asked for the dynamic segment. counters: totals (R, N) by name. spread: what
    shares carried, where they have no length of their own.
    """

    step: int
    truth: Array
    readings: Array
    control: Array | None
    belief: Gaussian
    ages: np.ndarray
    sends: np.ndarray
    asked: np.ndarray
    counters: Counters
    spread: Spread | None


def run(network: Network) -> Iterator[Instant]:
    """The steps of all runs, one after the other."""
    fleet, plant = network.fleet, network.plant
    content, truth, control = fleet.start(network.prior), network.initial_state, None
    memory = network.controller.memory if network.controller else None
    arbiter = network.contest_memory
    deliver = _delivery(network.delivery, len(truth))
    for step in range(network.steps):
        if step > 0:
            control, memory = _steer(network, fleet.belief(content), truth, memory, step - 1)
            truth = plant.advance(truth, control, network.process[step - 1], step - 1)
        readings = deliver(plant.observe(truth, network.measurement[step], step), step)
        content = fleet.begin_step(content, readings, control, step)
        sends, asked = [], []
        for cycle in range(step * network.rounds, (step + 1) * network.rounds):
            content, arbiter, speak, ask = _cycle(network, content, arbiter, cycle)
            sends.append(speak)
            asked.append(ask)
        yield Instant(
            step,
            truth,
            readings,
            control,
            fleet.belief(content),
            fleet.ages(content),
            np.stack(sends),
            np.stack(asked),
            fleet.counters(content),
            fleet.spread(content),
        )


def _steer(
    network: Network, belief: Gaussian, truth: Array, memory: Any, last: int
) -> tuple[Array | None, Any]:
    """What drives the plants on from step `last` (R, p), and what the controller remembers."""
    if network.controller is None:
        return None, memory
    law, _, node = network.controller
    return law(truth if node is None else belief.mean[:, node], memory, last)


def _delivery(delivery: Delivery | None, runs: int) -> Callable[[Array, int], Array]:
    """What lies between sensors and nodes, with a memory for each run."""
    if delivery is None:
        return lambda readings, step: readings
    memories = [delivery.memory] * runs

    def deliver(readings: Array, step: int) -> Array:
        delivered = []
        for run_, taken in enumerate(readings):
            memories[run_], arrived = delivery.transmit(memories[run_], taken, step)
            delivered.append(arrived)
        return np.stack(delivered)

    return deliver


def _cycle(
    network: Network, content: Any, arbiter: Any, cycle: int
) -> tuple[Any, Any, np.ndarray, np.ndarray]:
    """A cycle, group by group; and who sent in it and asked for its dynamic segment: (R, N)."""
    shape = (len(network.initial_state), network.schedule.nodes)
    spoke, asked = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    lost = None if network.lost is None else network.lost(cycle)
    for number in range(len(network.schedule.groups(cycle))):
        arbiter, speak, ask = _access(network, arbiter, content, (cycle, number), spoke)
        content = network.fleet.exchange(content, speak, lost)
        spoke, asked = spoke | speak, asked | ask
    return content, arbiter, spoke, asked


def _access(
    network: Network, arbiter: Any, content: Any, part: tuple[int, int], spoke: np.ndarray
) -> tuple[Any, np.ndarray, np.ndarray]:
    """Who sends in a part (cycle, group) and who asks for its dynamic slots: (R, N) each; nobody
    sends twice in a cycle, and nodes `spoke` (R, N) have."""
    cycle, number = part
    schedule = network.schedule
    group = schedule.groups(cycle)[number]
    sends, asked = np.zeros((2, *spoke.shape), dtype=bool)
    sends[:, list(group.senders)] = True
    contenders = np.array(contenders_left(schedule, cycle, ()), dtype=np.int64)
    if group.dynamic_slots and len(contenders):
        bids = network.fleet.bids(content, contenders)
        bids = np.where(spoke[:, contenders], NO_BID, bids)
        arbiter, wins = network.contest(arbiter, cycle, number, contenders, bids)
        asked[:, contenders] = bids != NO_BID
        sends[:, contenders] = wins
    return arbiter, sends, asked
