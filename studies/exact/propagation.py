"""The moments of all errors of a network, step by step, without a random number.

Between two steps all is in one vector z: the errors of the N nodes' beliefs and of the held shares,
and behind them the state of the plant where a filter believes something wrong. For given
covariances a step maps the means linearly. The network's own code computes the map: one lane for
each unit of a mean or of a reading, and one with all of them, which shows that the map is linear.
Covariances do not depend on the means; the lanes must agree on them.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import symmetrise
from concord.nodes.rules.belief_consensus import HeldBeliefs
from concord.studies.exact.network import ExactNetwork
from concord.studies.exact.truth import NotExact

_ALIKE = 1e-9
_SETTLED = 1e-14


class JointMoments(NamedTuple):
    """A step after its last round, of P loss patterns.

    reported: covariances that nodes believe (P, N, n, n). mean: E[e] (P, Z). errors: Cov[e]
    (P, Z, Z), of errors of all N n states first, then of held shares.
    """

    reported: np.ndarray
    mean: np.ndarray
    errors: np.ndarray


class StepMap(NamedTuple):
    """Means after a step: gain (P, Z, Z) of means before, `readings` (P, Z, Y) of readings, and
    `offset` (P, Z) of both at zero."""

    gain: np.ndarray
    readings: np.ndarray
    offset: np.ndarray


class Joint(NamedTuple):
    """Mean (P, Z) and covariance (P, Z, Z) of errors, with the plant's state behind them where the
    network `follows` it."""

    mean: np.ndarray
    cov: np.ndarray


def propagate(network: ExactNetwork, patterns: Sequence[int] = (0,)) -> Iterator[JointMoments]:
    """Yield the moments of each step for the losses of runs of these numbers.

    Raises:
        NotExact: a rule whose estimates are not linear in the readings.
    """
    n, count = len(network.truth.F), 1 if network.links.perfect else len(patterns)
    size = (network.scenario.nodes + len(network.slot_links)) * n
    lanes = _Lanes(network, patterns[:count])
    joint = beginning(network, count, size)
    for step in range(network.scenario.steps):
        found, reported = lanes.step(step)
        joint = moved(network, joint, found, step)
        yield JointMoments(reported, joint.mean[:, :size], joint.cov[:, :size, :size])


def beginning(network: ExactNetwork, count: int, size: int) -> Joint:
    """Return the errors of the prior mean, which all beliefs have, and the plant's state."""
    n = len(network.truth.F)
    (state, of_state), (mean, of_mean) = network.truth.state, network.truth.mean
    gain = np.tile(of_mean - of_state, (size // n, 1))
    middle = np.tile(mean - state, size // n)
    if network.follows:
        gain, middle = np.concatenate([gain, of_state]), np.concatenate([middle, state])
    return Joint(np.tile(middle, (count, 1)), np.tile(gain @ gain.T, (count, 1, 1)))


def moved(network: ExactNetwork, joint: Joint, found: StepMap, step: int) -> Joint:
    """Return the joint moments after a step of the plant and of all nodes.

    A mean is m = x + e, readings are y = H x' + v + b, and x' = F x + E w + d. The error after the
    step is A e + (A 1 + B H F - F) x + (B H - 1) (E w + d) + B (v + b) + c. Where the filters
    believe what is true, the factor of x is zero; c and the part of d that they know cancel.

    Raises:
        NotExact: the factor of x is not zero, and the network does not follow x.
    """
    truth, (A, B, offset) = network.truth, found
    count, size, n = len(A), A.shape[-1], len(truth.F)
    ones = np.tile(np.eye(n), (size // n, 1))
    F = truth.F if step > 0 else np.eye(n)
    entered = B @ truth.H - ones
    of_state = A @ ones + entered @ F
    d = np.zeros(n)
    if step > 0:
        d = network.plant.advance(d, None, np.zeros(truth.E.shape[1]), step - 1)
    if network.follows:
        below = np.concatenate([np.zeros((n, size)), F], axis=-1)
        A = np.concatenate([A, of_state], axis=-1)
        A = np.concatenate([A, np.broadcast_to(below, (count, *below.shape))], axis=-2)
        entered = np.concatenate([entered, np.broadcast_to(np.eye(n), (count, n, n))], axis=-2)
        B = np.concatenate([B, np.zeros((count, n, B.shape[-1]))], axis=-2)
        offset = np.concatenate([offset, np.zeros((count, n))], axis=-1)
    else:
        scale = 1 + np.abs(A).sum(axis=-1, keepdims=True)
        if (np.abs(of_state) > _ALIKE * scale * (1 + np.abs(F).max())).any():
            raise NotExact(f"{network.scenario.name} --exact: a filter believes another sensor")
        offset = 0.0
        if step > 0:
            d = d - network.model.transition(np.zeros(n), None, step - 1)
    mean = (A @ joint.mean[..., None])[..., 0] + B @ truth.bias + entered @ d + offset
    cov = A @ joint.cov @ A.mT + _square(B @ truth.D)
    if step > 0:
        cov = cov + _square(entered @ truth.E)
    return Joint(mean, symmetrise(cov))


class _Lanes:
    """The network's nodes in P (1 + C + 1) lanes: none, one unit each, and all together."""

    def __init__(self, network: ExactNetwork, patterns: Sequence[int]) -> None:
        self._network, self._patterns = network, patterns
        self._lost_in = network.lost_in(patterns)
        scenario, truth = network.scenario, network.truth
        n = len(truth.F)
        self._shape = scenario.nodes, n
        self._sees = ~np.isnan(truth.delivered).ravel()
        means = (scenario.nodes + len(network.slot_links)) * n
        units = np.eye(means + int(self._sees.sum()))
        # Signs and sizes differ, so that no two effects cancel in the lane with all of them.
        together = np.cos(np.arange(1.0, len(units) + 1)) * 2
        self._columns = np.concatenate([0 * units[:1], units, together[None]])
        self._means, self._lanes = means, len(self._columns)
        runs = len(patterns) * self._lanes
        prior = Gaussian(
            np.zeros((runs, scenario.nodes, n)),
            np.broadcast_to(truth.prior_cov, (runs, scenario.nodes, n, n)),
        )
        self._content = network.rule.start(prior)
        self._kept: dict[int, tuple[list[np.ndarray], Any, StepMap, np.ndarray]] = {}

    def step(self, step: int) -> tuple[StepMap, np.ndarray]:
        """Return the map of a step, and what nodes report after it (P, N, n, n)."""
        phase = step % self._network.period_steps
        repeats = step > 0 and self._network.links.perfect
        if self._network.follows and repeats:
            # The offset has the inputs that a filter knows, which may change with the step.
            repeats = not self._network.model.transition(
                np.zeros(self._shape[1]), None, step - 1
            ).any()
        before = self._signature() if repeats else []
        if repeats and phase in self._kept and _settled(self._kept[phase][0], before):
            _, self._content, found, reported = self._kept[phase]
            return found, reported
        found, reported = self._computed(step)
        if repeats:
            self._kept[phase] = before, self._content, found, reported
        return found, reported

    def _computed(self, step: int) -> tuple[StepMap, np.ndarray]:
        network = self._network
        rule, truth, count = network.rule, network.truth, len(self._patterns)
        runs = count * self._lanes
        readings = np.broadcast_to(truth.delivered.ravel(), (self._lanes, self._sees.size)).copy()
        readings[:, self._sees] += self._columns[:, self._means :]
        readings = np.tile(readings, (count, 1)).reshape(runs, *truth.delivered.shape)
        content = rule.begin_step(self._with_means(), readings, None, step)
        cycles = range(step * network.scenario.rounds, (step + 1) * network.scenario.rounds)
        for cycle in cycles:
            lost = self._lost_in(step, cycle)
            lost = None if lost is None else np.repeat(lost, self._lanes, axis=0)
            for sends in network.groups(cycle):
                content = rule.exchange(content, np.tile(sends, (runs, 1)), lost)
        self._content = content
        belief = rule.belief(content)
        reported = belief.cov.reshape(count, self._lanes, *self._shape, self._shape[1])
        self._check_covs(reported)
        return self._map(belief.mean), reported[:, 0]

    def _with_means(self) -> Any:
        """The content with the means of the lanes' columns."""
        network, known = self._network, self._content.known
        nodes, n = self._shape
        columns = np.tile(self._columns[:, : self._means], (len(self._patterns), 1))
        blocks = columns.reshape(len(columns), -1, n)
        belief = known.own.belief._replace(mean=blocks[:, :nodes])
        held = known.held
        if isinstance(held, HeldBeliefs):
            mean = held.beliefs.mean
            there = blocks[:, nodes:][:, network.link_slots] if network.holds else 0 * mean
            held = held._replace(beliefs=held.beliefs._replace(mean=there))
        own = known.own._replace(belief=belief)
        return self._content._replace(known=known._replace(own=own, held=held))

    def _map(self, mean: np.ndarray) -> StepMap:
        network, count = self._network, len(self._patterns)
        after = mean
        if network.holds:
            held = self._content.known.held.beliefs.mean[:, network.slot_links]
            after = np.concatenate([mean, held], axis=1)
        after = after.reshape(count, self._lanes, self._means)
        effects = after[:, 1:-1] - after[:, :1]
        together, expected = after[:, -1] - after[:, 0], self._columns[-1] @ effects
        scale = np.abs(self._columns[-1]) @ np.abs(effects) + np.abs(after[:, 0])
        if (np.abs(together - expected) > _ALIKE * (scale + 1e-300)).any():
            raise NotExact(
                f"rule {network.scenario.rule.name} --exact: its estimates are not linear in the "
                "readings; use runs"
            )
        whole = effects.mT
        readings = np.zeros((count, self._means, self._sees.size))
        readings[..., self._sees] = whole[..., self._means :]
        return StepMap(whole[..., : self._means], readings, after[:, 0])

    def _check_covs(self, reported: np.ndarray) -> None:
        first = reported[:, :1]
        variances = np.diagonal(first, axis1=-2, axis2=-1).max(axis=-1)[..., None, None]
        if not (np.abs(reported - first) <= 1e-6 * np.abs(variances)).all():
            raise NotExact(
                f"rule {self._network.scenario.rule.name} --exact: its covariances depend on the "
                "readings, or are not finite; use runs"
            )

    def _signature(self) -> list[np.ndarray]:
        """The covariances and ages of the lane without errors, on which all that follows hangs."""
        known = self._content.known
        signature = [known.own.belief.cov[0]]
        if isinstance(known.held, HeldBeliefs):
            signature.append(known.held.ages[0].astype(float))
            if self._network.holds:
                signature.append(known.held.beliefs.cov[0])
        return signature


def _settled(before: list[np.ndarray], now: list[np.ndarray]) -> bool:
    """Whether covariances and ages are those of a period before, to rounding."""
    return all(
        (np.abs(one - other) <= _SETTLED * np.abs(one).max(initial=0.0)).all()
        for one, other in zip(before, now, strict=True)
    )


def _square(factor: np.ndarray) -> np.ndarray:
    return factor @ factor.mT
