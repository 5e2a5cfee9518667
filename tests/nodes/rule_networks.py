"""Networks of any fusion rule for the tests of nodes/, with sensors that see a part each."""

from dataclasses import replace

import numpy as np

from concord.bus.flexray.share_frames import read_frame
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.runtime.in_process import Link
from concord.scenarios.catalogue import definition_named
from concord.scenarios.node_context import NodeContext, RuleContext
from concord.scenarios.rule_table.rules import build_estimator, hold_policy
from tests.nodes.networks import (
    Adjacency,
    Network,
    Outcome,
    WholeState,
    network,
    run,
)

FRESH = ("hcmci", "icf", "diffusion", "kcf", "centralised")
ALL = ("ci", "wac", "local", *FRESH)
F = 0.98 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
Q = np.array([[0.2, 0.05], [0.05, 0.1]])


def noise_cov(node: int) -> np.ndarray:
    """Return a noise covariance whose precise direction differs from node to node."""
    angle = 0.7 * node
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return turn @ np.diag([0.3, 5.0 + node]) @ turn.T


def ruled(
    rule: str,
    adjacency: Adjacency,
    priors: list[Gaussian],
    *,
    steps: int,
    rounds: int,
    seeing: list[int],
    schedule: Schedule | None = None,
    number: str = "<f8",
    seed: int = 0,
) -> Network:
    """Nodes with these priors that fuse by a rule, on this graph (N, N), Metropolis weights."""
    net = network(
        adjacency,
        priors,
        steps=steps,
        rounds=rounds,
        matrix=F,
        process_noise_cov=Q,
        schedule=schedule,
        seeing=seeing,
        number=number,
        seed=seed,
    )
    usual = definition_named("oscillator").defaults
    scenario = usual.with_(nodes=len(priors), rule=rule, steps=steps)
    neighbours = [node.neighbours for node in net.nodes]
    nodes = []
    for config in net.nodes:
        plain = config.estimator
        context = RuleContext(len(priors[0].mean), neighbours, hold_policy(scenario), 0.0, number)
        node_context = NodeContext(
            config.index,
            context,
            plain.place.weights,  # type: ignore[attr-defined]
            model=plain.model,  # type: ignore[attr-defined]
            sensor=WholeState(noise_cov(config.index)) if config.index in seeing else None,
            prior=priors[config.index],
            filter=plain.filter,  # type: ignore[attr-defined]
        )
        estimator = build_estimator(scenario, node_context)
        bus = TimelessBus(config.schedule, estimator.share_bytes)
        nodes.append(replace(config, estimator=estimator, bus=bus))
    return net._replace(nodes=nodes)


def weight_matrix(net: Network) -> np.ndarray:
    """Return the Metropolis weights (N, N) of a network, from its neighbours."""
    weights = np.zeros((len(net.nodes), len(net.nodes)))
    for node in net.nodes:
        for j in node.neighbours:
            degree = max(len(node.neighbours), len(net.nodes[j].neighbours))
            weights[node.index, j] = 1 / (1 + degree)
        weights[node.index, node.index] = 1 - weights[node.index].sum()
    return weights


def losing_links(seed: int, probability: float) -> Link:
    """A link that loses all frames of a share, whatever is in them: the same for every rule."""

    def link(sender: int, receiver: int, frame: bytes) -> tuple[bytes, ...]:
        key = [seed, sender, receiver, read_frame(frame).cycle]
        return () if np.random.default_rng(key).random() < probability else (frame,)

    return link


def run_watched(net: Network, link: Link) -> tuple[Outcome, set[tuple[int, int, int]]]:
    """The outcome, and which (sender, receiver, cycle) arrived."""
    arrived = set()

    def watched(sender: int, receiver: int, frame: bytes) -> tuple[bytes, ...]:
        frames = tuple(link(sender, receiver, frame))
        if frames:
            arrived.add((sender, receiver, read_frame(frame).cycle))
        return frames

    return run(net, watched), arrived
