"""Run the rule `labelled` under faults, on the network of TRACK.

The faults are links that lose frames, a dead hub, a long path, and wrong readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.nodes.faults.losses import Outage
from concord.nodes.messages import Measured
from concord.nodes.node import NodeConfig
from concord.nodes.rules.labelled.flooding import LabelledContent, LabelledFlooding
from concord.results.records.trace import read_trace
from concord.runtime import in_process
from concord.runtime.batched import driver as batched
from concord.runtime.batched.build import build_network
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.baselines import centralised
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.catalogue import definition_named
from concord.scenarios.links import link_state
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup, generator

HUB, HUB_DEAD = 13, range(40, 70)
# Standard deviations of a restarted node's prior: so wide that it carries no information.
_LOST_DEVIATIONS = np.array([300.0, 15.0, 300.0, 15.0, 0.02])
# How far a wrong reading is off, in standard deviations of the noise, to either side.
_OUTLIER_DEVIATIONS = 10.0


class FaultCase(NamedTuple):
    """Faults of one case.

    The `options` say how many frames the links lose. The hub may die, and a fraction of the
    readings may be wrong.
    """

    options: dict[str, Any]
    hub_dies: bool = False
    outliers: float = 0.0


class CaseOutcome(NamedTuple):
    """Figures of one run.

    Squared errors (steps, N) and NEES over dimension (steps, N) are NaN while a node knows nothing.
    The squared errors of the centralised filter are (steps,); it hears each reading that is not
    wrong. Two pairs count the wrong readings and the others: how
    many there were, and how many of them the nodes refused.
    """

    squared: np.ndarray
    consistency: np.ndarray
    squared_centralised: np.ndarray
    wrong: int
    wrong_refused: int
    right: int
    right_refused: int


def runs_of_case(case: FaultCase, runs: int, seed: int = 1) -> list[CaseOutcome]:
    """Runs 0, 1, ... of TRACK in which this goes wrong: all at once, but for a node that dies."""
    chosen = {"scenario": "target-tracking", "nodes": 20, "rule": "labelled", **case.options}
    setup = prepare(scenario_of(**chosen, seed=seed))
    if case.hub_dies:
        return [
            outcome(setup_of_run(setup, run), _with_dead_hub(setup, run)) for run in range(runs)
        ]
    return _at_once(case, setup, runs)


class Course(NamedTuple):
    """Course of one run: truth (steps, n), readings (steps, N, r, d), beliefs (steps, N, n).

    `kept` and `wrong` (steps, N) mark readings.
    """

    truth: np.ndarray
    readings: np.ndarray
    belief: Gaussian
    kept: np.ndarray
    wrong: np.ndarray


def outcome(setup: Setup, course: Course) -> CaseOutcome:
    """Return the figures of one run."""
    wrong = course.wrong
    taken = np.logical_not(np.isnan(course.readings).all(axis=(2, 3)))
    right = np.where((wrong & taken)[..., None, None], np.nan, course.readings)
    central = centralised(setup, right, None)
    score = definition_named("target-tracking").score
    errors = course.belief.mean - course.truth[:, None]
    scored, place = list(score.nees_states), list(score.states)
    refused = taken & ~course.kept
    return CaseOutcome(
        (errors[..., place] ** 2).sum(-1),
        nees(errors[..., scored], course.belief.cov) / len(scored),
        ((central.mean - course.truth)[:, place] ** 2).sum(-1),
        int((wrong & taken).sum()),
        int((wrong & refused).sum()),
        int((~wrong & taken).sum()),
        int((~wrong & refused).sum()),
    )


def _at_once(case: FaultCase, setup: Setup, runs: int) -> list[CaseOutcome]:
    own = [setup_of_run(setup, run) for run in range(runs)]
    network = build_network(setup, range(runs))
    measurement, wrong = _spoiled(network.measurement, case.outliers, own)
    network = replace(network, measurement=measurement)
    instants = list(batched.run(network))
    truth, readings, mean, cov = (
        np.stack(values, axis=1)
        for values in zip(*((i.truth, i.readings, *i.belief) for i in instants), strict=True)
    )
    kept = np.stack([_kept(instant) for instant in instants], axis=1)
    courses = zip(truth, readings, map(Gaussian, mean, cov), kept, wrong, strict=True)
    return [outcome(one, Course(*course)) for one, course in zip(own, courses, strict=True)]


def _kept(instant: batched.Instant) -> np.ndarray:
    """Return the nodes that recorded their reading (R, N)."""
    assert instant.spread is not None, "the rule is labelled"
    return np.diagonal(instant.spread.held[:, :, -1], axis1=1, axis2=2)


def _with_dead_hub(setup: Setup, run: int) -> Course:
    setup = setup_of_run(setup, run)
    recorded: set[tuple[int, int]] = set()
    nodes = [_node(setup, node, recorded) for node in range(setup.scenario.nodes)]
    recorder = MemoryRecorder()
    in_process.run(build_environment(setup), nodes, recorder)
    trace = read_trace(setup, recorder.messages)
    kept = np.zeros(trace.readings.shape[:2], dtype=bool)
    kept[tuple(np.array(sorted(recorded)).T)] = True
    belief = Gaussian(trace.mean, trace.cov)
    wrong = np.zeros_like(kept)
    return Course(trace.truth, trace.readings, belief, kept, wrong)


def _node(setup: Setup, node: int, recorded: set[tuple[int, int]]) -> NodeConfig:
    config = build_node(setup, node)
    assert isinstance(config.estimator, LabelledFlooding)
    lost_at = HUB_DEAD.stop if node == HUB else None
    estimator = Observed(config.estimator, recorded, lost_at)
    outages = [
        Outage(sender, receiver, HUB_DEAD.start, HUB_DEAD.stop)
        for receiver, heard in enumerate(setup.neighbours)
        for sender in heard
        if HUB in (sender, receiver)
    ]
    links = link_state(setup)._replace(outages=tuple(outages))
    return replace(config, estimator=estimator, links=links)


def _spoiled(
    noise: np.ndarray, share: float, own: Sequence[Setup]
) -> tuple[np.ndarray, np.ndarray]:
    """Noise (steps, R, N, r, d) of these runs with this share of it wrong, and which (R, steps, N)
    that is."""
    spoiled, wrong = noise.copy(), []
    for run, setup in enumerate(own):
        draw = generator(setup.scenario, "outliers", 0)
        there = draw.random(noise[:, run].shape[:2]) < share
        side = np.where(draw.random(noise[:, run].shape) < 0.5, -1.0, 1.0)
        spoiled[:, run] += np.where(there[..., None, None], _OUTLIER_DEVIATIONS * side, 0.0)
        wrong.append(there)
    return spoiled, np.stack(wrong)


@dataclass(frozen=True)
class Observed:
    """An estimator that notes the (step, node) of what it records, and that forgets everything
    before the step `lost_at`."""

    inner: LabelledFlooding
    recorded: set[tuple[int, int]]
    lost_at: int | None

    def begin_step(
        self, content: LabelledContent, measured: Measured
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """As the inner one, after a cold restart where it is time."""
        if measured.step == self.lost_at:
            mean = self.inner.belief(content).mean
            away = mean + _LOST_DEVIATIONS * np.array([1.0, 0.0, -1.0, 0.0, 0.0])
            prior = Gaussian(away, np.diag(_LOST_DEVIATIONS**2))
            content = self.inner.restart(prior, content)
        content, failures = self.inner.begin_step(content, measured)
        if self.inner.node in content.kept.records[-1]:
            self.recorded.add((measured.step, self.inner.node))
        return content, failures

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)
