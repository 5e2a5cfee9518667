"""Small networks for the tests of nodes/: a linear plant, chosen priors, links that lose frames."""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array

from concord.bus.flexray.slotted_bus import Slots
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import Schedule, dynamic_only, full_publish, hybrid, round_robin
from concord.filters.fusion import hold
from concord.filters.fusion.averaging import INFORMATION, MOMENTS, Averaged
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import unpack_upper
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.environment_state import ControlStep, EnvironmentConfig
from concord.nodes.faults.losses import LinkState
from concord.nodes.messages import Estimate, decode, from_wire
from concord.nodes.node import NodeConfig, NodeState
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.belief_consensus import BeliefConsensus, HoldPolicy
from concord.nodes.rules.lane_rule import Place
from concord.nodes.vector_codec import BeliefCodec
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.topology.weights import metropolis

Adjacency = NDArray[np.bool_]

DROP = HoldPolicy(lambda base, ages, inverse_volume, cycles: hold.drop(base, ages), carried=False)
PREDICT = HoldPolicy(lambda base, ages, inverse_volume, cycles: hold.full(base, ages), carried=True)
DECAYED = HoldPolicy(
    lambda base, ages, inverse_volume, cycles: hold.held_weights(base, ages, 0.5, inverse_volume),
    carried=True,
    by_inverse_volume=True,
)
HOLDS = {"drop": DROP, "predict": PREDICT, "decayed": DECAYED}
SEEDS = st.integers(0, 2**32 - 1)
TURN = 0.98 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])


@dataclass(frozen=True)
class Linear:
    """Plant and model at once: x -> F x + u + noise. Some nodes read the whole state."""

    matrix: np.ndarray
    noise_cov: np.ndarray
    seeing: tuple[int, ...] = ()
    nodes: int = 1

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        moved = state @ self.matrix.T
        return moved if control is None else moved + control

    def process_noise_cov(self, step: int) -> np.ndarray:
        return self.noise_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        return self.transition(state, control, step) + noise

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        delivered = np.full((self.nodes, 1, len(state)), np.nan)
        for node in self.seeing:
            delivered[node, 0] = state + noise[node, 0]
        return delivered


class WholeState(NamedTuple):
    """A sensor that reads the state."""

    noise_cov: np.ndarray
    gate: float | None = None

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        return state

    def residual(self, value: np.ndarray, predicted: np.ndarray, /) -> np.ndarray:
        return value - predicted

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return delivered, self.noise_cov


class Draws(NamedTuple):
    process: np.ndarray
    measurement: np.ndarray


class Network(NamedTuple):
    """Configurations of one network for the in-process driver."""

    environment: EnvironmentConfig
    nodes: list[NodeConfig]


def with_slots(config: NodeConfig, slots: Slots) -> NodeConfig:
    """The node on a bus on which a share has these slots: (node, cycle) -> slots."""
    bus = TimelessBus(config.schedule, config.estimator.share_bytes)
    bus.slots = slots
    return replace(config, bus=bus)


def network(
    adjacency: Adjacency,
    priors: Sequence[Gaussian],
    *,
    steps: int,
    rounds: int,
    matrix: np.ndarray | None = None,
    process_noise_cov: np.ndarray | None = None,
    average: Averaged = MOMENTS,
    hold_policy: HoldPolicy = DROP,
    schedule: Schedule | None = None,
    number: str = "<f8",
    seeing: Sequence[int] = (),
    lead: int = 4,
    controller: ControlStep | None = None,
    seed: int = 0,
) -> Network:
    """Nodes with these priors on this graph (N, N), Metropolis weights, a linear plant."""
    count, n = len(adjacency), len(priors[0].mean)
    plant = Linear(
        np.eye(n) if matrix is None else matrix,
        np.zeros((n, n)) if process_noise_cov is None else process_noise_cov,
        tuple(seeing),
        count,
    )
    weights = metropolis(csr_array(adjacency)).toarray()
    schedule = full_publish(count) if schedule is None else schedule
    codec = BeliefCodec(n, number)
    bus = TimelessBus(schedule, codec.size)
    generator = np.random.default_rng(seed)
    nodes = []
    graph = [np.flatnonzero(row).tolist() for row in adjacency]
    for i, heard in enumerate(graph):
        estimator = AtNode(
            BeliefConsensus(average, hold_policy, n),
            Place(np.array(i), weights[i, [i, *heard]]),
            model=plant,
            sensor=WholeState(0.5 * np.eye(n)) if i in seeing else None,
            prior=priors[i],
            filter=SigmaPointFilter(scaled_unscented(n)),
            codec=codec.vector,
        )
        nodes.append(NodeConfig(i, graph, rounds, steps, bus, estimator))
    environment = EnvironmentConfig(
        plant=plant,
        initial_state=np.ones(n),
        states=n,
        draws=Draws(
            0.1 * generator.standard_normal((steps, n)),
            0.5 * generator.standard_normal((steps, count, 1, n)),
        ),
        nodes=count,
        steps=steps,
        rounds=rounds,
        lead=lead,
        bus=bus,
        controller=controller,
        neighbours=[node.neighbours for node in nodes],
    )
    return Network(environment, nodes)


class Outcome(NamedTuple):
    """Results of a run: mean (steps, N, n), cov (steps, N, n, n), all messages, final states."""

    mean: np.ndarray
    cov: np.ndarray
    estimates: list[Estimate]
    messages: list[tuple[str, bytes]]
    states: list[NodeState]

    def same_bits(self, other: "Outcome") -> bool:
        ours, theirs = ((o.mean.tobytes(), o.cov.tobytes()) for o in (self, other))
        return ours == theirs

    def counted(self, name: str) -> int:
        """A counter, summed over the nodes."""
        return sum(state.counters.get(name, 0) for state in self.states)


def run(
    net: Network,
    link: in_process.Link = in_process.lossless,
    pick: in_process.Pick = in_process.first_come,
) -> Outcome:
    """Run a network in this process."""
    recorder = MemoryRecorder()
    states = in_process.run(net.environment, net.nodes, recorder, link=link, pick=pick)
    return outcome(recorder.messages, states)


def outcome(messages: list[tuple[str, bytes]], states: list[NodeState]) -> Outcome:
    """Arrays from messages."""
    found = [decode(t, data) for t, data in messages if t.startswith("estimate/")]
    found.sort(key=lambda e: (e.step, e.node))
    count = len(states)
    mean = np.array([from_wire(e.mean) for e in found])
    cov = unpack_upper(np.array([from_wire(e.cov) for e in found]))
    n = mean.shape[-1]
    shape = (-1, count, n)
    return Outcome(mean.reshape(shape), cov.reshape(*shape, n), found, messages, states)


def with_links(net: Network, links: LinkState) -> Network:
    """The network with links that lose frames."""
    return net._replace(nodes=[replace(node, links=links) for node in net.nodes])


def losing(seed: int, probability: float) -> in_process.Link:
    """A link that loses frames, each at random but the same whenever it is sent."""

    def link(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        fate = np.random.default_rng([seed, sender, receiver, zlib.crc32(frame)]).random()
        return () if fate < probability else (frame,)

    return link


def shuffled(seed: int) -> in_process.Pick:
    """Deliver any waiting message next."""
    generator = np.random.default_rng(seed)
    return lambda waiting: int(generator.integers(waiting))


def last_come(waiting: int) -> int:
    """Deliver the newest message first: the most unfair order that there is."""
    return waiting - 1


def random_cov(generator: np.random.Generator, n: int) -> np.ndarray:
    """A covariance (n, n) with a condition number of some tens."""
    root = generator.standard_normal((n, n + 2))
    return root @ root.T + 0.2 * np.eye(n)


def random_priors(generator: np.random.Generator, count: int, n: int) -> list[Gaussian]:
    """A belief for each node."""
    return [Gaussian(generator.standard_normal(n), random_cov(generator, n)) for _ in range(count)]


@st.composite
def graphs(draw: st.DrawFn, least: int = 1, most: int = 6) -> Adjacency:
    """Connected graphs (N, N): a random tree and some links more."""
    count = draw(st.integers(least, most))
    adjacency = np.zeros((count, count), dtype=bool)
    for node in range(1, count):
        parent = draw(st.integers(0, node - 1))
        adjacency[node, parent] = adjacency[parent, node] = True
    pairs = [(i, j) for i in range(count) for j in range(i)]
    for i, j in draw(st.lists(st.sampled_from(pairs), max_size=6)) if pairs else ():
        adjacency[i, j] = adjacency[j, i] = True
    return adjacency


def path(count: int) -> Adjacency:
    """The path graph (N, N)."""
    return np.eye(count, k=1, dtype=bool) | np.eye(count, k=-1, dtype=bool)


def ring(count: int) -> Adjacency:
    """The ring graph (N, N)."""
    adjacency = path(count)
    adjacency[0, -1] = adjacency[-1, 0] = True
    return adjacency


def schedules(count: int) -> st.SearchStrategy[Schedule]:
    """Every kind of schedule: static, in turns, with a dynamic segment, with nothing else."""
    some = st.integers(1, count).map(lambda slots: round_robin(count, slots))
    occupancy = st.sampled_from([0.3, 0.5, 0.8])
    return st.one_of(
        st.just(full_publish(count)),
        some,
        occupancy.map(lambda part: hybrid(count, part)),
        occupancy.map(lambda part: dynamic_only(count, part)),
    )


@st.composite
def networks(draw: st.DrawFn) -> Network:
    """Networks of a few nodes, some of which see, over a few steps."""
    adjacency = draw(graphs(least=2, most=5))
    count = len(adjacency)
    generator = np.random.default_rng(draw(SEEDS))
    return network(
        adjacency,
        random_priors(generator, count, 2),
        steps=draw(st.integers(1, 4)),
        rounds=draw(st.integers(1, 3)),
        matrix=TURN,
        process_noise_cov=0.1 * np.eye(2),
        average=draw(st.sampled_from([MOMENTS, INFORMATION])),
        hold_policy=HOLDS[draw(st.sampled_from(sorted(HOLDS)))],
        schedule=draw(schedules(count)),
        seeing=draw(st.lists(st.sampled_from(range(count)), unique=True)),
        seed=draw(st.integers(0, 99)),
    )
