"""The exact errors of a network: of each node and step, steady state, worst phase, convergence."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.filters.linalg import cholesky, inverse_spd, symmetrise
from concord.results.figures.intervals import Interval, ratio_t
from concord.scenarios.catalogue import definition_of
from concord.scenarios.setup import Setup
from concord.studies.exact.network import ExactNetwork, exact_network
from concord.studies.exact.propagation import Joint, StepMap, beginning, moved, propagate
from concord.studies.exact.truth import believed_transition, weighed_rows

PATTERNS = 20
"""Patterns of losses where links lose frames; without losses there is one."""
_ROUNDING = 1e-12


class Steady(NamedTuple):
    """The last period of the schedule.

    error: of the network over that period. worst_phase: which step of the period, counted from the
    run's first step, has the largest error, and that error. rate: factor by which the distance from
    the steady state shrinks in a step; above 1 for a network that diverges; NaN where rounding
    hides it. settled: the error has changed by less than a millionth in that period.
    """

    error: float
    worst_phase: int
    worst_error: float
    rate: float
    settled: bool


@dataclass(frozen=True)
class Exact:
    """Second moments of the errors of a network, for P patterns of losses (1 without losses).

    reported, errors: covariances (P, S, N, n, n) that nodes believe, and E[e e'] of their errors.
    bias: (P, S, N, n), E[e]. spread: (P, S, N), E of the squared distance from the nodes' average
    in the scored states. centralised, centralised_errors: (S, n, n) of one filter that hears all.
    """

    setup: Setup
    reported: np.ndarray
    errors: np.ndarray
    bias: np.ndarray
    spread: np.ndarray
    centralised: np.ndarray
    centralised_errors: np.ndarray
    period_steps: int

    @cached_property
    def squares(self) -> np.ndarray:
        """Mean squared errors (P, S, N) in the scored states."""
        return _trace_of(self.errors, self._score.states)

    @cached_property
    def nees(self) -> np.ndarray:
        """Expected normalised squared errors per state (P, S, N); 1 is honest on the average."""
        return _nees(self.reported, self.errors, self._score.nees_states)

    @cached_property
    def honesty(self) -> np.ndarray:
        """Claimed over true mean squared error (P, S, N) in the scored states; below 1 a node
        claims too much."""
        return _trace_of(self.reported, self._score.states) / self.squares

    @cached_property
    def overconfidence(self) -> np.ndarray:
        """Largest eigenvalue of P^-1 E[e e'] (P, S, N): above 1 some direction is overconfident."""
        whitener = np.linalg.inv(cholesky(self.reported))
        return np.linalg.eigvalsh(symmetrise(whitener @ self.errors @ whitener.mT))[..., -1]

    @property
    def rmse(self) -> Interval:
        """Root mean square error of all nodes over the scored steps, as `cc.figures` has it; the
        interval is over the patterns of losses, and has no width without losses."""
        squares = self.squares[:, self.scored].mean(axis=(1, 2))
        if len(squares) == 1:
            one = float(np.sqrt(squares[0]))
            return Interval(one, one, one)
        return ratio_t(squares, np.ones_like(squares))

    @property
    def rmse_node(self) -> np.ndarray:
        """The same of each node (N,)."""
        return np.sqrt(self.squares[:, self.scored].mean(axis=(0, 1)))

    @property
    def rmse_centralised(self) -> float:
        """The same of one filter that hears everything."""
        return float(np.sqrt(self.squares_centralised[self.scored].mean()))

    @property
    def squares_centralised(self) -> np.ndarray:
        """Mean squared errors (S,) of that filter."""
        return _trace_of(self.centralised_errors, self._score.states)

    @property
    def nees_centralised(self) -> np.ndarray:
        """Its expected normalised squared errors per state (S,)."""
        return _nees(self.centralised, self.centralised_errors, self._score.nees_states)

    @property
    def anees(self) -> float:
        """Expected normalised squared error per state over nodes and scored steps."""
        return float(self.nees[:, self.scored].mean())

    @property
    def scored(self) -> slice:
        """The steps that count."""
        return slice(min(self._score.first_step, self.squares.shape[1] - 1), None)

    @property
    def _score(self):
        return definition_of(self.setup.scenario).score

    @property
    def steady(self) -> Steady:
        """Return the last period, and how fast the network came there."""
        error, period = self.squares.mean(axis=(0, 2)), self.period_steps
        last = error[-period:]
        steps = np.arange(len(error))[-period:]
        worst = int(np.argmax(last))
        change = np.abs(error[period:] - error[:-period])
        moves = np.flatnonzero(change > _ROUNDING * error[period:])
        rate = np.nan
        if len(moves) > period and np.isfinite(change).all():
            end = int(moves[-1])
            # From the last changes that rounding leaves, a period apart.
            first = max(end - period * max(1, (end // period) // 2), 0)
            if change[first] > 0 and end > first:
                rate = float((change[end] / change[first]) ** (1 / (end - first)))
        settled = bool(len(change) and change[-1] <= 1e-6 * error[-1])
        return Steady(
            float(np.sqrt(last.mean())), int(steps[worst] % period), float(np.sqrt(last[worst])),
            rate, settled,
        )  # fmt: skip


def exact_of(setup: Setup, patterns: Sequence[int] = range(PATTERNS)) -> Exact:
    """Return the exact errors of a network; `patterns` are run numbers whose losses are taken.

    Raises:
        NotExact: what has no exact form.
    """
    network = exact_network(setup)
    score = definition_of(setup.scenario).score
    n, nodes = len(network.truth.F), setup.scenario.nodes
    states = list(score.states)
    reported, errors, bias, spread = [], [], [], []
    for moments in propagate(network, patterns):
        mean = moments.mean.reshape(len(moments.mean), -1, n)[:, :nodes]
        blocks = moments.errors.reshape(len(mean), -1, n, moments.errors.shape[-1] // n, n)
        blocks = blocks[:, :nodes, :, :nodes] + mean[..., None, None] * mean[:, None, None]
        own = np.stack([blocks[:, i, :, i] for i in range(nodes)], axis=1)
        near = blocks[:, :, states][..., states]
        joint = np.einsum("pisjs->pij", near)
        diagonal = np.diagonal(joint, axis1=-2, axis2=-1)
        spread.append(diagonal - 2 * joint.mean(axis=-1) + joint.mean(axis=(-1, -2))[:, None])
        reported.append(moments.reported)
        errors.append(own)
        bias.append(mean)
    central = list(_centralised(network))
    return Exact(
        setup,
        np.stack(reported, axis=1),
        np.stack(errors, axis=1),
        np.stack(bias, axis=1),
        np.maximum(np.stack(spread, axis=1), 0.0),
        np.stack([cov for cov, _ in central]),
        np.stack([error for _, error in central]),
        network.period_steps,
    )


def _centralised(network: ExactNetwork) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield what one filter with all readings believes (n, n), and its E[e e'], of each step."""
    truth, setup, model = network.truth, network.setup, network.model
    n, weighed = len(truth.F), weighed_rows(truth, network.rule.filters.groups)
    F, offset = believed_transition(model, n), np.zeros(n)
    cov, joint = np.array(setup.prior_cov), beginning(network, 1, n)
    for step in range(setup.scenario.steps):
        moves = np.eye(n)
        if step > 0:
            moves = F
            cov = symmetrise(F @ cov @ F.T) + model.process_noise_cov(step - 1)
            offset = model.transition(np.zeros(n), None, step - 1)
        information = weighed @ truth.H
        cov = np.linalg.solve(np.eye(n) + cov @ information, cov)
        cov = symmetrise(cov)
        keeps = np.eye(n) - cov @ information
        found = StepMap((keeps @ moves)[None], (cov @ weighed)[None], (keeps @ offset)[None])
        joint: Joint = moved(network, joint, found, step)
        mean = joint.mean[0, :n]
        yield cov, joint.cov[0, :n, :n] + np.outer(mean, mean)


def _trace_of(matrices: np.ndarray, states: Sequence[int]) -> np.ndarray:
    return np.diagonal(matrices, axis1=-2, axis2=-1)[..., list(states)].sum(axis=-1)


def _nees(reported: np.ndarray, errors: np.ndarray, states: Sequence[int]) -> np.ndarray:
    chosen = np.ix_(states, states)
    inside = (..., *chosen)
    return np.trace(inverse_spd(reported[inside]) @ errors[inside], axis1=-2, axis2=-1) / len(
        states
    )
