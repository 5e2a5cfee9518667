"""What the rule `labelled` makes of a bus that loses frames, a dead hub, a cut, and a long path.

The network is TRACK's. What goes wrong does so between the nodes: in the link of the in-process
driver, and in a node that forgets.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from experiments.options import ScenarioOptions
from experiments.trace import read_trace
from filters.gaussian import Gaussian
from filters.metrics import nees
from nodes import in_process
from nodes.in_process import Link
from nodes.labelled import Content, LabelledFlooding
from nodes.messages import Array, Measured
from nodes.recording import MemoryRecorder
from nodes.share import cycle_of
from scenarios.baselines import centralised
from scenarios.build import build_node, build_world
from scenarios.catalogue import kind_of
from scenarios.setup import Setup, prepare

HUB, HUB_DEAD = 13, range(40, 70)
CUT = range(50, 70)
# What a restarted node believes, one standard deviation: as little as nothing.
_LOST_DEVIATIONS = np.array([300.0, 15.0, 300.0, 15.0, 0.02])


class Case(NamedTuple):
    """What goes wrong: frames lost at random for each receiver, the hub, or the cut."""

    options: dict[str, Any]
    loss: float = 0.0
    hub_dies: bool = False
    cut: bool = False


class CaseOutcome(NamedTuple):
    """Squared errors (steps, N) and NEES over dimension (steps, N), NaN while a node knows nothing;
    squared errors of the centralised filter (steps,)."""

    squared: Array
    consistency: Array
    squared_centralised: Array


def run_case(case: Case, run: int, seed: int = 1) -> CaseOutcome:
    """One run of TRACK in which this goes wrong."""
    chosen = {"scenario": "target-tracking", "nodes": 20, "rule": "labelled", **case.options}
    setup = prepare(ScenarioOptions(**chosen, run=run, seed=seed).resolve())
    nodes = [build_node(setup, node) for node in range(setup.scenario.nodes)]
    if case.hub_dies:
        hub = nodes[HUB].estimator
        assert isinstance(hub, LabelledFlooding)
        nodes[HUB] = replace(nodes[HUB], estimator=Restarting(hub, HUB_DEAD.stop))
    recorder = MemoryRecorder()
    in_process.run(build_world(setup), nodes, recorder, link=_link(case, setup, run))
    trace = read_trace(setup, recorder.messages)
    central = centralised(setup, trace.readings, trace.control)
    score = kind_of("target-tracking").score
    errors = trace.mean - trace.truth[:, None]
    scored = list(score.nees_states)
    place = list(score.states)
    return CaseOutcome(
        (errors[..., place] ** 2).sum(-1),
        nees(errors[..., scored], trace.cov) / len(scored),
        ((central.mean - trace.truth)[:, place] ** 2).sum(-1),
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


def _link(case: Case, setup: Setup, run: int) -> Link:
    side = halves(setup)
    rounds = setup.scenario.rounds

    def link(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        cycle = cycle_of(frame)
        step = cycle // rounds
        if case.hub_dies and step in HUB_DEAD and HUB in (sender, receiver):
            return ()
        if case.cut and step in CUT and side[sender] != side[receiver]:
            return ()
        draw: Callable[[], float] = np.random.default_rng([run, sender, receiver, cycle]).random
        return () if case.loss and draw() < case.loss else (frame,)

    return link


@dataclass(frozen=True)
class Restarting:
    """An estimator that forgets everything before the step `at_step`."""

    inner: LabelledFlooding
    at_step: int

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """As the inner one, after a cold restart where it is time."""
        if measured.step == self.at_step:
            mean = content.window.belief.mean
            away = mean + _LOST_DEVIATIONS * np.array([1.0, 0.0, -1.0, 0.0, 0.0])
            prior = Gaussian(away, np.diag(_LOST_DEVIATIONS**2))
            content = self.inner.restart(prior, content.window.heartbeats)
        return self.inner.begin_step(content, measured)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)
