"""What the rule `labelled` makes of links that lose frames, a dead hub, a cut, a long path, and of
readings that are wrong. The network is TRACK's."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from experiments.options import ScenarioOptions
from experiments.trace import read_trace
from filters.gaussian import Gaussian
from filters.metrics import nees
from nodes import in_process
from nodes.labelled import Content, LabelledFlooding
from nodes.link_state import LinkState, Outage
from nodes.messages import Array, Measured
from nodes.recording import MemoryRecorder
from nodes.state_machine import NodeConfig
from nodes.world import WorldConfig
from scenarios.baselines import centralised
from scenarios.build import build_node, build_world
from scenarios.catalogue import kind_of
from scenarios.links import link_state
from scenarios.setup import Setup, generator, prepare

HUB, HUB_DEAD = 13, range(40, 70)
CUT = range(50, 70)
# What a restarted node believes, one standard deviation: as little as nothing.
_LOST_DEVIATIONS = np.array([300.0, 15.0, 300.0, 15.0, 0.02])
# How far a wrong reading is off, in standard deviations of the noise, to either side.
_OUTLIER_DEVIATIONS = 10.0


class Case(NamedTuple):
    """What goes wrong: with the links (`options` say how many frames they lose), the hub, the
    network in two, a share of the readings."""

    options: dict[str, Any]
    hub_dies: bool = False
    cut: bool = False
    outliers: float = 0.0


class CaseOutcome(NamedTuple):
    """What came of a run.

    Squared errors (steps, N) and NEES over dimension (steps, N), NaN while a node knows nothing;
    squared errors of the centralised filter (steps,), which hears everything that is not wrong;
    bytes said per step; of all readings that are wrong, and of all others: how many there were, and
    how many of them were refused.
    """

    squared: Array
    consistency: Array
    squared_centralised: Array
    said_bytes: float
    wrong: int
    wrong_refused: int
    right: int
    right_refused: int


def run_case(case: Case, run: int, seed: int = 1) -> CaseOutcome:
    """One run of TRACK in which this goes wrong."""
    chosen = {"scenario": "target-tracking", "nodes": 20, "rule": "labelled", **case.options}
    setup = prepare(ScenarioOptions(**chosen, run=run, seed=seed).resolve())
    recorded: set[tuple[int, int]] = set()
    nodes = [_node(case, setup, node, recorded) for node in range(setup.scenario.nodes)]
    world, wrong = _spoiled(build_world(setup), case.outliers, setup)
    recorder = MemoryRecorder()
    in_process.run(world, nodes, recorder)
    trace = read_trace(setup, recorder.messages)
    taken = np.logical_not(np.isnan(trace.readings).all(axis=(2, 3)))
    right = np.where((wrong & taken)[..., None, None], np.nan, trace.readings)
    central = centralised(setup, right, trace.control)
    score = kind_of("target-tracking").score
    errors = trace.mean - trace.truth[:, None]
    scored, place = list(score.nees_states), list(score.states)
    assert trace.spread is not None
    kept = np.zeros(taken.shape, dtype=bool)
    kept[tuple(np.array(sorted(recorded)).T)] = True
    refused = taken & ~kept
    return CaseOutcome(
        (errors[..., place] ** 2).sum(-1),
        nees(errors[..., scored], trace.cov) / len(scored),
        ((central.mean - trace.truth)[:, place] ** 2).sum(-1),
        float(trace.spread.body_bytes.mean()),
        int((wrong & taken).sum()),
        int((wrong & refused).sum()),
        int((~wrong & taken).sum()),
        int((~wrong & refused).sum()),
    )


def halves(setup: Setup) -> np.ndarray:
    """Two parts (N,) of the network that each hang together: the eight nodes nearest by hops to the
    first node with which that is so, and the rest."""
    everybody = set(range(len(setup.neighbours)))
    for root in sorted(everybody):
        near = set(_reached(setup, root, everybody)[:8])
        rest = everybody - near
        if len(_reached(setup, min(rest), rest)) == len(rest):
            return np.isin(sorted(everybody), sorted(near))
    raise ValueError("no eight nodes leave the others connected; use another graph")


def _reached(setup: Setup, root: int, allowed: set[int]) -> list[int]:
    """The allowed nodes that can be reached through allowed ones, the nearest first."""
    found = [root]
    for node in found:
        found += [j for j in setup.neighbours[node] if j in allowed and j not in found]
    return found


def _node(case: Case, setup: Setup, node: int, recorded: set[tuple[int, int]]) -> NodeConfig:
    config = build_node(setup, node)
    assert isinstance(config.estimator, LabelledFlooding)
    lost_at = HUB_DEAD.stop if case.hub_dies and node == HUB else None
    estimator = Observed(config.estimator, recorded, lost_at)
    return replace(config, estimator=estimator, links=_links(case, setup))


def _links(case: Case, setup: Setup) -> LinkState:
    """The links of the scenario, and what is cut for a while."""
    side = halves(setup) if case.cut else np.zeros(setup.scenario.nodes, dtype=bool)
    outages = []
    for receiver, heard in enumerate(setup.neighbours):
        for sender in heard:
            if case.hub_dies and HUB in (sender, receiver):
                outages.append(Outage(sender, receiver, HUB_DEAD.start, HUB_DEAD.stop))
            if side[sender] != side[receiver]:
                outages.append(Outage(sender, receiver, CUT.start, CUT.stop))
    return link_state(setup)._replace(outages=tuple(outages))


class _Spoiled(NamedTuple):
    process: Array
    measurement: Array


def _spoiled(world: WorldConfig, share: float, setup: Setup) -> tuple[WorldConfig, np.ndarray]:
    """The world in which this share of the readings is wrong, and which those are (steps, N)."""
    noise = world.draws.measurement
    draw = generator(setup.scenario, "outliers", 0)
    wrong = draw.random(noise.shape[:2]) < share
    side = np.where(draw.random(noise.shape) < 0.5, -1.0, 1.0)
    spoiled = np.where(wrong[..., None, None], noise + _OUTLIER_DEVIATIONS * side, noise)
    return replace(world, draws=_Spoiled(world.draws.process, spoiled)), wrong


@dataclass(frozen=True)
class Observed:
    """An estimator that notes the (step, node) of what it records, and that forgets everything
    before the step `lost_at`."""

    inner: LabelledFlooding
    recorded: set[tuple[int, int]]
    lost_at: int | None

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """As the inner one, after a cold restart where it is time."""
        if measured.step == self.lost_at:
            mean = content.window.belief.mean
            away = mean + _LOST_DEVIATIONS * np.array([1.0, 0.0, -1.0, 0.0, 0.0])
            prior = Gaussian(away, np.diag(_LOST_DEVIATIONS**2))
            content = self.inner.restart(prior, content.window.heartbeats)
        content, troubles = self.inner.begin_step(content, measured)
        if self.inner.node in content.window.records[-1]:
            self.recorded.add((measured.step, self.inner.node))
        return content, troubles

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)
