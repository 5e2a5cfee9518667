"""An estimator that is looked at after every cycle, and otherwise does what another does."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from concord.features.sets.set_membership import SetAtNode
from concord.filters.fusion.averaging import Averaged, Fused
from concord.filters.gaussian import Gaussian, joined
from concord.nodes.changes import Settings, Standing
from concord.nodes.estimator import AnyEstimator, EarlierBelief, Rejected
from concord.nodes.messages import Measured
from concord.nodes.node_state import NodeConfig
from concord.nodes.rules import information_rounds
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.belief_consensus import BeliefConsensus
from concord.nodes.rules.fresh_consensus import FreshConsensus
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.novelty_rounds import NoveltyRounds
from concord.nodes.vector_codec import belief_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.rules import TrimmedCovarianceIntersection
from tests.laboratory.averages import broken_promise, promised_weights
from tests.laboratory.broken import Broken
from tests.laboratory.ledger import OracleLedger
from tests.laboratory.promises import nodes_are_honest, sensors_are_honest

_ROUNDING = 1e-9
_REFUSALS = ("rejected not-positive-definite", "rejected unsound")
_CONTRADICTIONS = ("contradicting-share", "contradicting-reading")


class _Share(NamedTuple):
    """Share as an estimator decoded it, with its body."""

    meaning: Any
    body: bytes


def watched(
    config: NodeConfig, ledger: OracleLedger, original: Scenario, settings: Settings | None = None
) -> NodeConfig:
    """Return the same node, and every node that it becomes, with an eye on its estimator.

    All settings of a network apply together to its original scenario.
    """
    rebuild = config.rebuild

    def rebuilt(standing: Standing, step: int, belief: EarlierBelief | None) -> NodeConfig:
        assert rebuild is not None, "a node of a scenario can be rebuilt"
        return watched(rebuild(standing, step, belief), ledger, original, standing.settings)

    scenario, _ = original.with_known(**(settings or {}))
    return replace(config, estimator=WatchedEstimator(config, ledger, scenario), rebuild=rebuilt)


class _ShownRule(NamedTuple):
    """A rule of averages whose weights are shown to `check`, as they are used."""

    rule: Averaged
    check: Callable[[Gaussian, np.ndarray, Gaussian], None]

    def fuse(
        self, own: Gaussian, others: Gaussian, weights: np.ndarray, by_inverse_volume: bool
    ) -> Fused:
        """Fuse the beliefs by the rule, and check the result."""
        fused = self.rule.fuse(own, others, weights, by_inverse_volume)
        # If a share is no belief, the estimator calls the rule again without it.
        if not np.isnan(fused.inverse_volume[1:]).any():
            self.check(joined(own, others), fused.weights, fused.belief)
        return fused


class WatchedEstimator:
    """Estimator of a node, with the invariants that must hold after every cycle.

    A broken invariant raises `Broken`.
    """

    def __init__(self, config: NodeConfig, ledger: OracleLedger, scenario: Scenario) -> None:
        self._config, self._ledger, self._scenario = config, ledger, scenario
        self._inner = self._with_weights_shown(config.estimator)
        self._cycle = self._group = -1
        self._heard: dict[int, int] = {}
        self._used: set[tuple[int, int]] = set()
        self._honest = sensors_are_honest(scenario) and nodes_are_honest(scenario)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def begin_step(self, content: Any, measured: Measured) -> tuple[Any, tuple[str, ...]]:
        """Begin a step; check that the last step had all cycles, and each cycle all groups."""
        config = self._config
        cycle = config.first_cycle + (measured.step - config.first_step) * config.rounds
        if (self._cycle, self._group) not in ((-1, -1), (cycle, 0)):
            raise self._broken("every cycle is gone through", f"step {measured.step} began")
        self._cycle, self._group = cycle, 0
        content, failures = self._inner.begin_step(content, measured)
        self._check_belief(self._inner.belief(content), _ROUNDING)
        self._check_failures(failures)
        return content, failures

    def accept(self, body: bytes) -> _Share:
        """Decode a body into a share that keeps the body."""
        try:
            meaning = self._inner.accept(body)
        except Rejected:
            self._ledger.rejected(self._config.index, body)
            raise
        self._ledger.accepted(self._config.index, body)
        return _Share(meaning, body)

    def fuse(self, content: Any, shares: tuple[_Share | None, ...]) -> tuple[Any, tuple[str, ...]]:
        """Fuse the shares; check that they belong to this cycle and that the result is valid."""
        near = self._config.neighbours
        came = {j: share for j, share in zip(near, shares, strict=True) if share is not None}
        for sender, share in came.items():
            self._check_share(sender, share)
        self._ledger.missed(self._config, self._cycle, self._group, {*near} - {*came})
        self._check_mixing(content, [j in came for j in near])
        meanings = tuple(None if share is None else share.meaning for share in shares)
        content, failures = self._inner.fuse(content, meanings)
        refused = {j for j, share in came.items() if self._is_indefinite(share.body)}
        self._check_refusals(len(refused), sum(trouble in _REFUSALS for trouble in failures))
        self._heard.update(dict.fromkeys({*came} - refused, self._cycle))
        if "contradicting-share" in failures:
            self._forget_refused(self._inner.ages(content))
        self._check_failures(failures)
        self._check_belief(self._inner.belief(content), 0.0)
        self._group += 1
        if self._group == len(self._config.schedule.groups(self._cycle)):
            self._check_ages(self._inner.ages(content))
            self._cycle, self._group = self._cycle + 1, 0
        return content, failures

    def _forget_refused(self, ages: np.ndarray) -> None:
        """A set that has nothing in common with the own one is not held."""
        for sender, age in zip(self._config.neighbours, ages.tolist(), strict=True):
            if age < 0:
                self._heard.pop(sender, None)

    def _is_indefinite(self, body: bytes) -> bool:
        """Return whether a share is a belief with a variance that is negative."""
        if not isinstance(self._inner, AtNode) or self._inner.codec.what != "belief":
            return False
        belief = belief_of(self._inner.codec.decode(body), len(self._inner.prior.mean))
        return bool((np.diagonal(belief.cov) < 0).any())

    def _check_refusals(self, indefinite: int, refused: int) -> None:
        """Check that each indefinite covariance is refused, and no other share."""
        if indefinite != refused:
            raise self._broken(
                "a covariance that is none is refused", f"{refused} shares for {indefinite}"
            )
        self._ledger.refused(self._config.index, refused)

    def _check_share(self, sender: int, share: _Share) -> None:
        label = (sender, self._cycle)
        if label in self._used:
            raise self._broken("no share used twice", f"that of node {sender} was used again")
        self._used.add(label)
        if self._ledger.record.body(*label) != share.body:
            raise self._broken(
                "a share is used in its own cycle", f"node {sender} has not said that in it"
            )
        self._ledger.used(self._config.index, *label)

    def _check_belief(self, belief: Gaussian, rounding: float) -> None:
        mean, cov = belief
        if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
            raise self._broken("estimates are finite", f"mean {mean.tolist()}")
        spread = np.sqrt(np.abs(np.diagonal(cov)))
        if (np.abs(cov - cov.T) > rounding * np.outer(spread, spread)).any():
            raise self._broken("covariances are symmetric", f"by {np.abs(cov - cov.T).max():.3g}")
        try:
            np.linalg.cholesky(cov)
        except np.linalg.LinAlgError:
            least = np.linalg.eigvalsh(cov).min()
            raise self._broken(
                "covariances are positive definite", f"least eigenvalue {least:.3g}"
            ) from None

    def _check_failures(self, failures: tuple[str, ...]) -> None:
        """Sets that hold the truth have it in common, if no sensor says what it does not read."""
        set_valued = isinstance(self._inner, SetAtNode) and self._honest
        bad = [trouble for trouble in failures if set_valued and trouble in _CONTRADICTIONS]
        if bad:
            raise self._broken("sets of the truth meet", bad[0])

    def _with_weights_shown(self, estimator: AnyEstimator) -> AnyEstimator:
        """Return the same estimator, with an eye on its weights over fresh and held beliefs."""
        if not (isinstance(estimator, AtNode) and isinstance(estimator.rule, BeliefConsensus)):
            return estimator
        rule = estimator.rule
        weigh = rule.hold.weigh

        def shown(
            base: np.ndarray, ages: np.ndarray, inverse_volume: np.ndarray, cycles: int
        ) -> np.ndarray:
            weights = weigh(base, ages, inverse_volume, cycles)
            promised = promised_weights(self._scenario, base, ages, inverse_volume, cycles)
            if np.abs(weights - promised).max() > _ROUNDING:
                raise self._broken(
                    "weights are those of the hold policy", f"{weights.tolist()} for {promised}"
                )
            return weights

        watched_rule = replace(
            rule,
            hold=rule.hold._replace(weigh=shown),
            average=_ShownRule(rule.average, self._check_average),
        )
        return replace(estimator, rule=watched_rule)

    def _check_average(self, beliefs: Gaussian, weights: np.ndarray, fused: Gaussian) -> None:
        self._check_weights(weights)
        liars = [
            1 + n for n, j in enumerate(self._config.neighbours) if j in self._ledger.record.liars
        ]
        rule = self._scenario.rule
        if isinstance(rule, TrimmedCovarianceIntersection) and np.isfinite(fused.mean).all():
            seen = broken_promise(beliefs, weights, fused, liars, rule.liars)
            if seen:
                raise self._broken("liars move nobody beyond what honest nodes say", seen)

    def _check_weights(self, weights: np.ndarray) -> None:
        if (weights < 0).any() or abs(weights.sum() - 1) > _ROUNDING:
            raise self._broken("weights sum to one", f"{weights.tolist()}")

    def _check_mixing(self, content: Any, came: list[bool]) -> None:
        """Check that a round keeps a value on which all agree: the used weights sum to one."""
        inner = self._inner
        if not (isinstance(inner, AtNode) and isinstance(inner.rule, FreshConsensus)):
            return
        rule, weights = inner.rule.exchange, inner.place.weights
        said = np.where([True, *came], 1.0, np.nan)[:, None]
        if isinstance(rule, InformationRounds):
            mixed = information_rounds.average(said, weights)
        elif isinstance(rule, NoveltyRounds):
            mixed = rule.mix(said * np.ones(len(inner.prior.mean)), weights)
        else:
            return
        if np.abs(mixed - 1).max() > _ROUNDING:
            raise self._broken("weights sum to one", f"a round makes {mixed.tolist()} of ones")

    def _check_ages(self, ages: np.ndarray) -> None:
        expected = [
            self._cycle - self._heard[j] if j in self._heard else -1
            for j in self._config.neighbours
        ]
        if ages.tolist() != expected:
            raise self._broken(
                "shares grow older by one a cycle", f"ages {ages.tolist()} for {expected}"
            )

    def _broken(self, invariant: str, seen: str) -> Broken:
        return Broken(invariant, f"node {self._config.index} in cycle {self._cycle}: {seen}")
