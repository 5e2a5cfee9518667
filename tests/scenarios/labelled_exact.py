"""Compare the promises of the rule `labelled` with independent searches and filters."""

from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.faults.losses import LinkState, hears
from concord.nodes.rules.labelled.flooding import LabelledContent, LabelledFlooding
from concord.results.records.trace import read_trace
from concord.runtime import in_process
from concord.runtime.drivers import in_memory
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.baselines import centralised
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.links import link_state
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from tests.nodes.record_search import Held, reachable, winners_of

# Every record is everywhere before its step is over.
_TRACKING: dict[str, Any] = {"scenario": "target-tracking", "nodes": 8, "schedule": "full"}
FULL_INFORMATION: tuple[dict[str, Any], ...] = (
    {**_TRACKING, "graph": "complete", "rounds": 1},
    {**_TRACKING, "graph": "path", "rounds": 7},
    {**_TRACKING, "graph": "ring", "rounds": 4, "relay": True},
    {"scenario": "meng2025-network", "graph": "complete", "rounds": 1},
    {"scenario": "oscillator", "nodes": 5, "graph": "star", "rounds": 2},
    {"scenario": "dc-motor-position", "graph": "complete", "rounds": 1, "stretch": 2.0},
)
STEPS, SEED = 12, 1
# Where frames are lost, only a rule that repeats all that is not confirmed is complete.
EVERYTHING: dict[str, Any] = {"repeat_above": 0.0, "repeat_bytes": 254}


class Audit(NamedTuple):
    """A random network, step by step and node by node.

    Attributes:
        pairs: how many (node, step, record) could be in use. missing: of these, not in use.
        deviation: of each node's last estimate from the filter that is given exactly the records
            in use, each once; relative to the state's scale.
    """

    pairs: int
    missing: int
    impossible: int
    deviation: float


def full_information(options: dict[str, Any]) -> float:
    """Largest deviation of any node at any step from the centralised filter (`deviation`)."""
    chosen = {"rule": "labelled", "steps": 40, "record_number": "float64", **options}
    setup = prepare(scenario_of(**chosen))
    trace = read_trace(setup, in_memory(setup))
    best = centralised(setup, trace.readings, trace.control)
    everybody = Gaussian(trace.mean.swapaxes(0, 1), trace.cov.swapaxes(0, 1))
    return deviation(everybody, best)


def deviation(belief: Gaussian, best: Gaussian) -> float:
    """How far beliefs (..., steps, n) are from the best (steps, n): means relative to the largest
    of each state, covariances to the standard deviations that they are made of."""
    scale = np.abs(best.mean).max(axis=0)
    # A node that has heard nothing stays at a prior mean of zero.
    scale = np.where(scale > 0, scale, 1.0)
    deviations = np.sqrt(np.einsum("...ii->...i", best.cov))
    means = np.abs(belief.mean - best.mean) / scale
    covs = np.abs(belief.cov - best.cov) / (deviations[..., None] * deviations[..., None, :])
    return float(max(means.max(), covs.max()))


def audit(number: int) -> Audit:
    """A network of a random graph, schedule, loss, window and plant."""
    options, links = _random_network(number)
    setup = prepare(scenario_of(**options))
    links = links._replace(key=link_state(setup).key)
    used, messages = _watched(setup, links)
    readings = read_trace(setup, messages).readings
    taken = {(int(t), int(j)) for t, j in np.argwhere(~np.isnan(readings).all(axis=(2, 3)))}
    rounds = setup.scenario.rounds
    node = build_node(setup, 0)
    assert isinstance(node.estimator, LabelledFlooding)
    possible = reachable(
        node.schedule,
        setup.neighbours,
        rounds,
        node.estimator.frames.window_steps,
        taken,
        winners_of(messages),
        lambda sender, receiver, cycle: hears(links, cycle // rounds, cycle, sender, receiver),
    )
    pairs = missing = impossible = 0
    for mine, could in zip(used, islice(possible, STEPS), strict=True):
        for has, might in zip(mine, could, strict=True):
            pairs += len(might)
            missing += len(might - has)
            impossible += len(has - might)
    return Audit(pairs, missing, impossible, _counted_once(options, links))


def _counted_once(options: dict[str, Any], links: LinkState) -> float:
    """The same network with a window that never passes, and readings that are not rounded."""
    options = {**options, "window_steps": STEPS, "digest_steps": 4, "record_number": "float64"}
    setup = prepare(scenario_of(**options))
    used, messages = _watched(setup, links)
    trace = read_trace(setup, messages)
    return max(
        deviation(
            Gaussian(trace.mean[-1:, node], trace.cov[-1:, node]),
            _given(setup, _only(trace.readings, labels), trace.control),
        )
        for node, labels in enumerate(used[-1])
    )


def _given(setup: Setup, readings: np.ndarray, control: np.ndarray | None) -> Gaussian:
    """The last belief (1, n) of the filter that has these readings."""
    best = centralised(setup, readings, control)
    return Gaussian(best.mean[-1:], best.cov[-1:])


def _only(readings: np.ndarray, labels: set[tuple[int, int]]) -> np.ndarray:
    kept = np.full_like(readings, np.nan)
    for step, source in labels:
        kept[step, source] = readings[step, source]
    return kept


def _watched(setup: Setup, links: LinkState) -> tuple[list[Held], list[tuple[str, bytes]]]:
    """Return the records that each node used after each step, and the recording."""
    log: list[list[set[tuple[int, int]]]] = [[] for _ in range(setup.scenario.nodes)]
    configs = []
    for node, seen in enumerate(log):
        config = build_node(setup, node)
        assert isinstance(config.estimator, LabelledFlooding)
        watched = RecordingEstimator(config.estimator, seen)
        configs.append(replace(config, estimator=watched, links=links))
    recorder = MemoryRecorder()
    in_process.run(build_environment(setup), configs, recorder)
    return [list(step) for step in zip(*log, strict=True)], recorder.messages


@dataclass(frozen=True)
class RecordingEstimator:
    """An estimator that notes at the end of each step which records it has used."""

    inner: LabelledFlooding
    seen: list[set[tuple[int, int]]]

    def belief(self, content: LabelledContent) -> Gaussian:
        """As the inner one says."""
        self.seen.append(content.kept.labels)
        return self.inner.belief(content)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


def _random_network(number: int) -> tuple[dict[str, Any], LinkState]:
    """So small that a frame has room for everything: what a frame cannot hold cannot arrive."""
    draw = np.random.default_rng([SEED, number])
    linear = bool(draw.integers(2))
    nodes = int(draw.integers(3, 9 if linear else 6))
    window = int(draw.integers(2, 7 if linear else 5))
    schedule = str(draw.choice(["full", "round-robin", "hybrid", "hybrid-leaves", "dynamic"]))
    options = {
        "scenario": "oscillator" if linear else "target-tracking",
        "rule": "labelled",
        "nodes": nodes,
        "steps": STEPS,
        "seed": number + 1,
        "graph": str(draw.choice(["ring", "path", "star", "complete"])),
        "rounds": int(draw.integers(1, 4)),
        "schedule": schedule,
        "occupancy": 1.0 if schedule == "full" else float(draw.choice([0.2, 0.4, 0.7])),
        "relay": bool(draw.integers(2)),
        "window_steps": window,
        "digest_steps": window,
        "payload_bytes": 254,
        **EVERYTHING,
    }
    there = draw.random((STEPS, nodes, nodes)) < draw.choice([0.5, 1.0])
    return options, LinkState(
        loss=float(draw.choice([0.0, 0.1, 0.3, 0.6])),
        link_up=None
        if there.all()
        else lambda step, sender, receiver: there[step, sender, receiver],
    )
