"""An estimator that is looked at after every cycle, and otherwise does what another does."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from experiments.torture_books import Books
from experiments.torture_broken import Broken
from experiments.torture_promises import nodes_are_honest, sensors_are_honest
from experiments.torture_trimmed import broken_promise
from experiments.torture_weights import promised_weights
from filters.fusion import Averaged, Fused
from filters.gaussian import Gaussian, joined
from nodes import information_rounds
from nodes.belief_consensus import BeliefConsensus
from nodes.changes import Standing
from nodes.estimator import Estimator, Rejected
from nodes.fresh_consensus import FreshConsensus
from nodes.information_rounds import InformationRounds
from nodes.messages import Array, Measured
from nodes.node_state import NodeConfig
from nodes.novelty_rounds import NoveltyRounds
from nodes.set_membership import SetMembership
from scenarios.scenario import Scenario

_ROUNDING = 1e-9
_REFUSALS = ("rejected not-positive-definite", "rejected unsound")
_CONTRADICTIONS = ("contradicting-share", "contradicting-reading")


class _Share(NamedTuple):
    """What an estimator made of a body, and the body."""

    meaning: Any
    body: bytes


def watched(config: NodeConfig, books: Books, scenario: Scenario) -> NodeConfig:
    """The same node, and every node that it becomes, with an eye on its estimator."""
    rebuild = config.rebuild

    def rebuilt(standing: Standing, step: int, belief: Gaussian | None) -> NodeConfig:
        assert rebuild is not None, "a node of a scenario can be rebuilt"
        changed = msgspec.structs.replace(scenario, **standing.settings)
        return watched(rebuild(standing, step, belief), books, changed)

    return replace(config, estimator=Watched(config, books, scenario), rebuild=rebuilt)


class _ShownRule(NamedTuple):
    """A rule of averages whose weights are shown to `check`, as they are used."""

    rule: Averaged
    check: Callable[[Gaussian, Array, Gaussian], None]

    def fuse(self, own: Gaussian, others: Gaussian, weights: Array, by_sharpness: bool) -> Fused:
        """What the rule makes of beliefs, looked at."""
        fused = self.rule.fuse(own, others, weights, by_sharpness)
        # With a share that is no belief it is asked once more, without it.
        if not np.isnan(fused.sharpness[1:]).any():
            self.check(joined(own, others), fused.weights, fused.belief)
        return fused


class Watched:
    """The estimator of a node, and what must hold of it after every cycle.

    Raises `Broken` where it does not.
    """

    def __init__(self, config: NodeConfig, books: Books, scenario: Scenario) -> None:
        self._config, self._books, self._scenario = config, books, scenario
        self._inner = self._with_weights_shown(config.estimator)
        self._cycle = self._group = -1
        self._heard: dict[int, int] = {}
        self._used: set[tuple[int, int]] = set()
        self._honest = sensors_are_honest(scenario) and nodes_are_honest(scenario)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def begin_step(self, content: Any, measured: Measured) -> tuple[Any, tuple[str, ...]]:
        """Every step has all of its cycles, and every cycle all of its parts."""
        config = self._config
        cycle = config.first_cycle + (measured.step - config.first_step) * config.rounds
        if (self._cycle, self._group) not in ((-1, -1), (cycle, 0)):
            raise self._broken("every cycle is gone through", f"step {measured.step} began")
        self._cycle, self._group = cycle, 0
        content, troubles = self._inner.begin_step(content, measured)
        self._check_belief(self._inner.belief(content), _ROUNDING)
        self._check_troubles(troubles)
        return content, troubles

    def accept(self, body: bytes) -> _Share:
        """The share, which remembers of what it was made."""
        try:
            meaning = self._inner.accept(body)
        except Rejected:
            self._books.rejected(self._config.index, body)
            raise
        self._books.accepted(self._config.index, body)
        return _Share(meaning, body)

    def fuse(self, content: Any, shares: tuple[_Share | None, ...]) -> tuple[Any, tuple[str, ...]]:
        """What goes in is what neighbours have said in this very cycle; what comes out is sound."""
        near = self._config.neighbours
        came = {j: share for j, share in zip(near, shares, strict=True) if share is not None}
        for sender, share in came.items():
            self._check_share(sender, share)
        self._books.missed(self._config, self._cycle, self._group, {*near} - {*came})
        self._check_mixing(content, [j in came for j in near])
        meanings = tuple(None if share is None else share.meaning for share in shares)
        content, troubles = self._inner.fuse(content, meanings)
        refused = {j for j, share in came.items() if self._is_indefinite(share.body)}
        self._check_refusals(len(refused), sum(trouble in _REFUSALS for trouble in troubles))
        self._heard.update(dict.fromkeys({*came} - refused, self._cycle))
        if "contradicting-share" in troubles:
            self._forget_refused(self._inner.ages(content))
        self._check_troubles(troubles)
        self._check_belief(self._inner.belief(content), 0.0)
        self._group += 1
        if self._group == len(self._config.schedule.groups(self._cycle)):
            self._check_ages(self._inner.ages(content))
            self._cycle, self._group = self._cycle + 1, 0
        return content, troubles

    def _forget_refused(self, ages: Array) -> None:
        """A set that has nothing in common with the own one is not held."""
        for sender, age in zip(self._config.neighbours, ages.tolist(), strict=True):
            if age < 0:
                self._heard.pop(sender, None)

    def _is_indefinite(self, body: bytes) -> bool:
        """Whether a share is a belief with a variance that is negative."""
        if not isinstance(self._inner, BeliefConsensus):
            return False
        return bool((np.diagonal(self._inner.codec.decode(body).cov) < 0).any())

    def _check_refusals(self, indefinite: int, refused: int) -> None:
        """What is no covariance is refused, and nothing else."""
        if indefinite != refused:
            raise self._broken(
                "a covariance that is none is refused", f"{refused} shares for {indefinite}"
            )
        self._books.refused(self._config.index, refused)

    def _check_share(self, sender: int, share: _Share) -> None:
        label = (sender, self._cycle)
        if label in self._used:
            raise self._broken("no share used twice", f"that of node {sender} was used again")
        self._used.add(label)
        if self._books.body(*label) != share.body:
            raise self._broken(
                "a share is used in its own cycle", f"node {sender} has not said that in it"
            )
        self._books.used(self._config.index, *label)

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

    def _check_troubles(self, troubles: tuple[str, ...]) -> None:
        """Sets that hold the truth have it in common, if no sensor says what it does not read."""
        certain = isinstance(self._inner, SetMembership) and self._honest
        bad = [trouble for trouble in troubles if certain and trouble in _CONTRADICTIONS]
        if bad:
            raise self._broken("sets of the truth meet", bad[0])

    def _with_weights_shown(self, estimator: Estimator) -> Estimator:
        """The same estimator, with an eye on its weights over fresh and held beliefs."""
        if not isinstance(estimator, BeliefConsensus):
            return estimator
        weigh = estimator.hold.weigh

        def shown(base: Array, ages: Array, sharpness: Array, cycles: int) -> Array:
            weights = weigh(base, ages, sharpness, cycles)
            promised = promised_weights(self._scenario, base, ages, sharpness, cycles)
            if np.abs(weights - promised).max() > _ROUNDING:
                raise self._broken(
                    "weights are those of the hold policy", f"{weights.tolist()} for {promised}"
                )
            return weights

        return replace(
            estimator,
            hold=estimator.hold._replace(weigh=shown),
            rule=_ShownRule(estimator.rule, self._check_average),
        )

    def _check_average(self, beliefs: Gaussian, weights: Array, fused: Gaussian) -> None:
        self._check_weights(weights)
        liars = [1 + n for n, j in enumerate(self._config.neighbours) if j in self._books.liars]
        if self._scenario.rule == "trimmed-ci" and np.isfinite(fused.mean).all():
            seen = broken_promise(beliefs, weights, fused, liars, self._scenario.liars)
            if seen:
                raise self._broken("liars move nobody beyond what honest nodes say", seen)

    def _check_weights(self, weights: Array) -> None:
        if (weights < 0).any() or abs(weights.sum() - 1) > _ROUNDING:
            raise self._broken("weights sum to one", f"{weights.tolist()}")

    def _check_mixing(self, content: Any, came: list[bool]) -> None:
        """What all agree on stays as it is, whoever was heard: the weights used sum to one."""
        if not isinstance(self._inner, FreshConsensus):
            return
        rule = self._inner.rule
        said = np.where([True, *came], 1.0, np.nan)[:, None]
        if isinstance(rule, InformationRounds):
            mixed = information_rounds.average(said, rule.weights)
        elif isinstance(rule, NoveltyRounds):
            mixed = rule.mix(said * np.ones(len(content.belief.mean)))
        else:
            return
        if np.abs(mixed - 1).max() > _ROUNDING:
            raise self._broken("weights sum to one", f"a round makes {mixed.tolist()} of ones")

    def _check_ages(self, ages: Array) -> None:
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
