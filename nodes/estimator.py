"""Estimator: a node's computation, apart from its timing; the interface of every fusion rule.

`nodes/node.py` decides when a step begins, which nodes are awaited and when a round is over; an
`Estimator` decides what is shared and what becomes of what was heard. Only the estimator reads its
`Content` and its `Share`; the state machine keeps them.
"""

from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from concord.bus.bus import Rejected as Rejected
from concord.filters.filter import Filter, begun, moments
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured, ReportedTracks
from concord.nodes.rules.local_filter import Model, at, predict_to_step

Content = TypeVar("Content")
Share = TypeVar("Share")


class Estimator(Protocol[Content, Share]):
    """A fusion rule at one node."""

    @property
    def share_bytes(self) -> int:
        """Length of the longest share that `compose` returns, for which a bus reserves slots."""
        ...

    def start(self) -> Content:
        """The content before the first step."""
        ...

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """Carry everything to this step and take the node's own readings.

        Returns the content and the names of what went wrong, to be counted.
        """
        ...

    def bid(self, content: Content) -> int | None:
        """How urgent a dynamic slot is (None: nothing to send)."""
        ...

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """Return the share to send now."""
        ...

    def next_bytes(self, content: Content) -> int:
        """Length of the share that `compose` would return."""
        ...

    def accept(self, body: bytes) -> Share:
        """The share that these bytes mean.

        Raises:
            Rejected: bytes that no sound peer would send.
        """
        ...

    def fuse(
        self, content: Content, shares: tuple[Share | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """End a round: one entry per neighbour in ascending order, None where nothing came."""
        ...

    def belief(self, content: Content) -> Gaussian:
        """The node's belief now: mean (n,), cov (n, n)."""
        ...

    def ages(self, content: Content) -> np.ndarray:
        """Communication cycles since the last share of each neighbour was sent; -1 is never."""
        ...


AnyEstimator = Estimator[Any, Any]


@runtime_checkable
class KeepsZonotope(Protocol):
    """An estimator that may keep a zonotope around the centre that `belief` tells."""

    def generators(self, content: Any) -> np.ndarray | None:
        """Its generators (n, q); None of another set."""
        ...


@runtime_checkable
class SolvesProgrammes(Protocol):
    """An estimator that may find a set by a convex programme."""

    def gap(self, content: Any) -> float | None:
        """How far at most the trace of the set is from the least, relative to it; None without."""
        ...


@runtime_checkable
class ChecksItself(Protocol):
    """An estimator that tests whether what it has heard fits its belief."""

    def is_suspect(self, content: Any) -> bool:
        """Whether it does not fit."""
        ...


@runtime_checkable
class KeepsTracks(Protocol):
    """An estimator that follows several targets, whose number `belief` tells."""

    def tracks(self, content: Any) -> ReportedTracks:
        """The tracks that stand for targets."""
        ...


@runtime_checkable
class WeighsShares(Protocol):
    """An estimator that may average the shares of its neighbours."""

    def weights(self, content: Any) -> np.ndarray | None:
        """Weights (J,) of the neighbours' shares in the last round; None where none were used."""
        ...


@runtime_checkable
class KeepsPast(Protocol):
    """An estimator that also estimates the states of past steps."""

    def smoothed(self, content: Any) -> Gaussian:
        """States of 0, 1, ... steps ago given all that the node knows: mean (L, n), cov (L, n, n);
        NaN where it knows none."""
        ...


class EarlierBelief(NamedTuple):
    """A belief (n,) about the state at `step`; `control` (p,) drove the plant last."""

    belief: Gaussian
    step: int
    control: np.ndarray | None = None

    def at_step(self, step: int, model: Model, filter: Filter) -> Gaussian:
        """Predict the belief to a step; it stays as it is where a prediction fails.

        The control of the steps between is not known: the last one is taken for each of them.
        """
        beliefs = begun(filter, Gaussian(self.belief.mean[None], self.belief.cov[None]))
        for number in range(self.step + 1, step + 1):
            moved, sound = predict_to_step(beliefs, self.control, number, model, filter)
            beliefs = moved if sound[0] else beliefs
        return at(moments(filter, beliefs), 0)
