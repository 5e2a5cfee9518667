"""Invariants of a whole run: no node is overconfident, and all nodes recover after `calm`."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from concord.filters.linalg import unpack_upper
from concord.nodes.messages import from_wire
from concord.scenarios.baselines import centralised, local_only
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.plants import noise_of
from concord.studies.check.drawn_networks import EXACT_PLANTS
from concord.studies.check.network_promise import (
    IMPROBABLE,
    SET_TOLERANCE,
    overconfidence,
    squares,
)
from tests.laboratory.broken import Broken
from tests.laboratory.promises import (
    BOUNDED,
    CERTAIN,
    CONSISTENT,
    GAUSSIAN,
    MATCHED,
    RETURNING,
    brings_back,
    forgets_no_share,
    nodes_are_honest,
    promises,
    sensors_are_honest,
)
from tests.laboratory.run_record import RunRecord

SETTLING_STEPS = 20
LEVEL_STEPS = 10
RECOVERY_STEPS = SETTLING_STEPS + LEVEL_STEPS

# How much more of an error or disagreement than in the run without faults is none, in variances:
# a factor, and a part of the variance itself.
_FACTOR, _PART = 2.0, 1.0
_SIZE = np.log(2.0)
# Below this part of the first ones variances are rounding: shares of single length carry 1e-7 of a
# state.
_ROUNDING = 1e-10


class EstimateHistory(NamedTuple):
    """Estimates of a run: mean (steps, N, n), cov (steps, N, n, n), NaN where a node was out.

    The truth is (steps, n); the readings are (steps, N, r, d), NaN without a reading. The control
    is (steps, p) or None. `heard` (steps, N): the node used a share that was sent in the step.
    `oldest` (steps, N): the age of the oldest share that the node kept, in steps; -1 for none.
    """

    setup: Setup
    truth: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    readings: np.ndarray
    control: np.ndarray | None
    heard: np.ndarray
    oldest: np.ndarray

    def same_bits(self, other: "EstimateHistory") -> bool:
        """Return whether all estimates are equal, bit for bit."""
        return (
            self.mean.tobytes() == other.mean.tobytes()
            and self.cov.tobytes() == other.cov.tobytes()
        )

    @property
    def errors(self) -> np.ndarray:
        """(steps, N, n)."""
        return self.mean - self.truth[:, None]


def history_of_run(setup: Setup, record: RunRecord) -> EstimateHistory:
    """Return the arrays of a run that came to its end.

    Raises:
        Broken: a node that was in said nothing, or one that was out did.
    """
    scenario = setup.scenario
    shape = (scenario.steps, scenario.nodes, len(setup.prior_mean))
    mean = np.full(shape, np.nan)
    cov = np.full((*shape, shape[-1]), np.nan)
    heard = np.zeros(shape[:-1], dtype=bool)
    oldest = np.full(shape[:-1], -1)
    rounds = record.history.rounds
    for step in range(scenario.steps):
        for node in range(scenario.nodes):
            said = record.estimates.get((step, node))
            if (said is not None) != record.history.is_in(node, step):
                what = "no" if said is None else "an"
                raise Broken("one estimate a step", f"node {node} gave {what} estimate of {step}")
            if said is not None:
                mean[step, node] = from_wire(said.mean)
                cov[step, node] = unpack_upper(from_wire(said.cov))
                heard[step, node] = any(0 <= age < rounds for age in said.ages)
                oldest[step, node] = max(said.ages, default=-1) // rounds
    truth = np.array([from_wire(record.truths[step].state) for step in range(scenario.steps)])
    return EstimateHistory(setup, truth, mean, cov, *_told(scenario, record), heard, oldest)


def _told(scenario: Scenario, record: RunRecord) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the readings and control that the environment has sent to the nodes."""
    some = next(iter(record.measured.values()))
    came = {
        place: np.array([from_wire(reading) for reading in measured.readings])
        for place, measured in record.measured.items()
    }
    shape = next(iter(came.values())).shape
    readings = np.full((scenario.steps, scenario.nodes, *shape), np.nan)
    for place, arrays in came.items():
        readings[place] = arrays
    if some.control is None:
        return readings, None
    first = {step: measured.control for (step, _), measured in record.measured.items()}
    return readings, np.array([first[step] for step in range(scenario.steps)], dtype=float)


def check_consistency(run: EstimateHistory) -> None:
    """No error lies beyond what its covariance allows, where the rule promises so.

    Raises:
        Broken: one does.
    """
    scenario = run.setup.scenario
    if not (sensors_are_honest(scenario) and nodes_are_honest(scenario)):
        return
    if promises(scenario, CERTAIN) and noise_of(scenario.plant) == "matched":
        most, invariant = 1.0 + SET_TOLERANCE, "a set holds the truth"
    elif promises(scenario, CONSISTENT) and scenario.name in MATCHED:
        most, invariant = float(chdtri(run.mean.shape[-1], IMPROBABLE)), "errors are as believed"
    else:
        return
    squared = squares(run.errors, run.cov)
    worst = float(np.nanmax(squared))
    if worst > most and not _errs_alone(run, most):
        step, node = np.unravel_index(np.nanargmax(squared), squared.shape)
        raise Broken(
            invariant,
            f"node {node} in step {step} errs by {worst:.4g} squared, at most {most:.4g}",
        )


def _errs_alone(run: EstimateHistory, most: float) -> bool:
    """Whether the filter errs beyond a bound on these readings without any network.

    On a nonlinear plant a filter approximates: a first reading after long may leave it too sure.
    The error is then the filter's, and no rule's. On a linear plant no filter may err so.
    """
    if run.setup.scenario.name not in {*MATCHED} - {*EXACT_PLANTS}:
        return False
    told = run.setup, run.readings, run.control
    one_by_one, together = local_only(*told), centralised(*told)
    alone = squares(one_by_one.mean - run.truth[:, None], one_by_one.cov)
    whole = squares(together.mean - run.truth, together.cov)
    return bool(max(np.nanmax(alone), np.nanmax(whole)) > most)


def check_bound(run: EstimateHistory) -> None:
    """Check that no covariance is smaller than that of the filter that hears every sensor.

    Unlike a large squared error, a wrong covariance shows in the very step in which information is
    counted twice.

    Raises:
        Broken: one is.
    """
    scenario = run.setup.scenario
    is_exact = scenario.name in EXACT_PLANTS and noise_of(scenario.plant) == "matched"
    if not (is_exact and promises(scenario, BOUNDED) and nodes_are_honest(scenario)):
        return
    if seen := overconfidence(run.setup, run.truth, run.readings, run.cov):
        raise Broken("nobody is surer than who hears all", seen)


def check_return(run: EstimateHistory, calm: EstimateHistory, calm_step: int) -> None:
    """After calm all are back: they err, disagree and doubt as they do where nothing was wrong.

    The level is that of `LEVEL_STEPS` steps, `SETTLING_STEPS` after the last fault, in units of the
    mean covariance of each node in these steps without faults. Which reading reaches a node in a
    single step is luck. Nothing is asked of runs that end before.

    Raises:
        Broken: a node is missing, or its error exceeds the level.
    """
    scenario = run.setup.scenario
    level = slice(calm_step + SETTLING_STEPS, calm_step + RECOVERY_STEPS)
    if level.stop > scenario.steps:
        return
    out = np.flatnonzero(np.isnan(run.mean[level]).any(axis=(0, 2)))
    if len(out):
        raise Broken("who was restarted is back", f"node {out[0]} is out {SETTLING_STEPS} steps on")
    honest = sensors_are_honest(scenario)
    # A set that a false reading has parted from the truth has nothing to find it again.
    if not promises(scenario, RETURNING if honest else GAUSSIAN):
        return
    if not brings_back(run.setup) or _is_rounding(calm, level) or _clings(run, calm, level):
        return
    if promises(scenario, CERTAIN):
        run, calm = _boxed(run), _boxed(calm)
    # How long a filter remembers what a sensor said falsely is a matter of its plant alone.
    compared = (("errors come back", _error), ("nodes agree again", _disagreement))
    for invariant, of in compared if honest else ():
        now, then = of(run, calm, level), of(calm, calm, level)
        if now > _FACTOR * then + _PART:
            raise Broken(invariant, f"{now:.4g} variances, and {then:.4g} without faults")
    # A node that hears little in some of these steps is back all the same. A node that hears
    # nothing in all of them shows nothing; the ledger accounts for every frame on its way to it.
    least, usual = _sizes(run, level).min(axis=0), _sizes(calm, level).mean(axis=0)
    grown = (least - usual)[run.heard[level].any(axis=0)].max(initial=0.0)
    if grown > _SIZE:
        raise Broken(
            "covariances come back", f"variances of a node are {np.exp(grown):.3g} times as large"
        )


def _clings(run: EstimateHistory, calm: EstimateHistory, level: slice) -> bool:
    """Whether a node keeps a share from before calm, as none does where nothing was wrong.

    A neighbour that wins no slot among all nodes wins one while others are out. Policy `predict`
    gives its last share full weight ever after, which costs what that share no longer knows.
    """
    clings = (run.oldest[level] >= SETTLING_STEPS) & (calm.oldest[level] < SETTLING_STEPS)
    return forgets_no_share(run.setup.scenario) and bool(clings.any())


def _boxed(run: EstimateHistory) -> EstimateHistory:
    """The same run with each state by itself.

    A single reading may cut a set to nearly nothing along a slanted direction. Whether it does is
    luck of the noise, and says nothing of a return.
    """
    variances = np.diagonal(run.cov, axis1=-2, axis2=-1)
    return run._replace(cov=variances[..., None] * np.eye(variances.shape[-1]))


def _is_rounding(calm: EstimateHistory, level: slice) -> bool:
    """Whether a filter without faults comes to know a state to its last digits.

    A plant whose noise does not reach each state lets that be. The cost of a fault then stays for
    good, in digits that rounding makes.
    """
    variances = np.diagonal(calm.cov, axis1=-2, axis2=-1)
    return bool(np.nanmin(variances[level] / variances[:1].max(axis=1)) < _ROUNDING)


def _error(run: EstimateHistory, calm: EstimateHistory, level: slice) -> float:
    """Mean square error over nodes and steps, per state, in variances of the calm run."""
    return _in_variances(run.errors[level], calm.cov[level])


def _disagreement(run: EstimateHistory, calm: EstimateHistory, level: slice) -> float:
    """Return the same of what nodes differ by from their mean."""
    mean = run.mean[level]
    apart = mean - mean.mean(axis=1, keepdims=True)
    return _in_variances(apart, calm.cov[level])


def _in_variances(away: np.ndarray, covs: np.ndarray) -> float:
    """Mean square per state of (steps, N, n), in the mean covariance of each node."""
    units = np.broadcast_to(covs.mean(axis=0), covs.shape)
    return float(squares(away, units).mean()) / away.shape[-1]


def _sizes(run: EstimateHistory, level: slice) -> np.ndarray:
    """Mean logarithm of the variances of each node in each step (steps, N)."""
    return np.linalg.slogdet(run.cov[level])[1] / run.mean.shape[-1]
