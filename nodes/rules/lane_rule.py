"""The one form of a fusion rule: pure functions over lanes, with an explicit axis of neighbours.

A lane is a node of a run. The knowledge of a rule has two parts: `own` values (...), one for each
lane, and `held` values (..., J), one for each neighbour of a lane. A node is batch (): its own
values have no leading axis, its held values have the axis J alone (`concord.nodes.rules.at_node`).
The batched driver has lanes (R, N) and holds one value for each link, (R, E); it gathers the links
of each node before it calls `fuse` (`concord.nodes.lanes.batch`). All other functions treat held
values one by one, so that they take both.
"""

from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from concord.bus.arbitration import NO_BID
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import solve_spd
from concord.nodes.rules.local_filter import (
    Carried,
    LocalFilters,
    LocalUpdate,
    Memory,
    predict_to_step,
    where,
)

FIRST_BID = 2**31 - 1
BID_RESOLUTION = 1 / 1024
BIDS_FOR_CHANGE = (64, 65536)
"""Bids between which urgency is told apart: of squared changes from 1/16 to 64."""


def bid_for_change(belief: Gaussian, published: Gaussian, trigger: float) -> np.ndarray:
    """Squared change since the last publication in units of the own covariance, quantised.

    Integers (...) for beliefs (..., n), so that arbitration does not hang on the last bit; below
    `FIRST_BID`, with which asks who has never published. `NO_BID` where the change is below the
    trigger.
    """
    change = belief.mean - published.mean
    squared = (change * solve_spd(belief.cov, change[..., None])[..., 0]).sum(axis=-1)
    # A change too large for its number, or for any, is as urgent as a change can be.
    urgency = np.nan_to_num(squared / BID_RESOLUTION, nan=np.inf)
    bids = np.clip(urgency, 0, FIRST_BID - 1).astype(np.int64)
    return np.where(squared < trigger, NO_BID, bids)


def asked(bid: np.ndarray) -> int | None:
    """One bid as a message carries it: None asks for nothing."""
    return None if bid == NO_BID else int(bid)


Failures = Mapping[str, np.ndarray]
"""How often what went wrong, by name: (...) booleans or integers."""

Own = TypeVar("Own")
Held = TypeVar("Held")
Share = TypeVar("Share")
Tree = TypeVar("Tree")


class Place(NamedTuple):
    """The place of lanes in the network.

    Attributes:
        node: which node each lane is, integers (...).
        weights: (..., 1 + J), the own first; 0 for a neighbour that a lane does not have.
    """

    node: np.ndarray
    weights: np.ndarray


class LaneContent(NamedTuple, Generic[Own, Held]):
    """Knowledge of lanes: named tuples of arrays; `cycles_in_step` counts the closed cycles, and
    `memory` is what the local filters have learnt, one entry for each group of sensors."""

    own: Own
    held: Held
    cycles_in_step: int
    memory: tuple[Memory | None, ...] = ()


class LocalStep(NamedTuple):
    """A step as the local filters of lanes take it: readings (..., r, d), control (..., p)."""

    filters: LocalFilters
    readings: np.ndarray
    control: np.ndarray | None
    step: int

    def predict(self, *beliefs: Gaussian) -> tuple[Carried, ...]:
        """Beliefs of the step before, own and held ones, at this step."""
        model, filter = self.filters.model, self.filters.filter
        if beliefs[0].mean.ndim > 1:
            return tuple(
                predict_to_step(one, self.control, self.step, model, filter) for one in beliefs
            )
        # The plant's functions cost a node more to enter than to evaluate.
        n = beliefs[0].mean.shape[-1]
        means = [one.mean.reshape(-1, n) for one in beliefs]
        together = Gaussian(
            np.concatenate(means), np.concatenate([one.cov.reshape(-1, n, n) for one in beliefs])
        )
        moved, sound = predict_to_step(together, self.control, self.step, model, filter)
        found, first = [], 0
        for one, fields in zip(beliefs, means, strict=True):
            lanes = slice(first, first := first + len(fields))
            here = Gaussian(
                moved.mean[lanes].reshape(one.mean.shape), moved.cov[lanes].reshape(one.cov.shape)
            )
            found.append(Carried(here, sound[lanes].reshape(one.mean.shape[:-1])))
        return tuple(found)

    def update(self, belief: Gaussian, memory: tuple[Memory | None, ...]) -> LocalUpdate:
        """Own beliefs (..., n) after the own readings."""
        return self.filters.update(belief, self.readings, self.step, memory)


class LaneRule(Protocol[Own, Held, Share]):
    """A fusion rule. Its shares travel as one vector of numbers (..., m)."""

    @property
    def contends(self) -> bool:
        """Return whether bids are asked for; without them no node must remember its shares."""
        ...

    def start(self, node: np.ndarray, prior: Gaussian, held: Gaussian) -> LaneContent[Own, Held]:
        """The content before the first step: priors (..., n), and the same (..., J, n) for each
        place of a neighbour."""
        ...

    def begin_step(
        self, node: np.ndarray, content: LaneContent[Own, Held], now: LocalStep
    ) -> tuple[LaneContent[Own, Held], Failures]:
        """Carry everything to this step and take the own readings."""
        ...

    def bid(self, content: LaneContent[Own, Held]) -> np.ndarray:
        """How urgent a dynamic slot is: integers (...), `NO_BID` for nothing to send."""
        ...

    def say(self, content: LaneContent[Own, Held]) -> np.ndarray:
        """The numbers (..., m) to share now."""
        ...

    def sent(self, content: LaneContent[Own, Held], sends: np.ndarray) -> LaneContent[Own, Held]:
        """After lanes `sends` (...) have shared."""
        ...

    def read(self, numbers: np.ndarray) -> tuple[Share, np.ndarray | None, str]:
        """Decode finite numbers (..., m).

        Return the content, which (...) can be used (None for all), and why the others cannot.
        """
        ...

    def fuse(
        self, place: Place, content: LaneContent[Own, Held], shares: Share, heard: np.ndarray
    ) -> tuple[LaneContent[Own, Held], Failures]:
        """End a cycle with what neighbours said (..., J), where `heard` (..., J) says that."""
        ...

    def belief(self, content: LaneContent[Own, Held]) -> Gaussian:
        """The beliefs now: (..., n), (..., n, n)."""
        ...

    def ages(self, content: LaneContent[Own, Held]) -> np.ndarray:
        """Cycles since the share of each neighbour was sent (..., J); -1 is never."""
        ...


@runtime_checkable
class AveragesShares(Protocol):
    """A rule whose rounds are weighted averages."""

    def weights(self, place: Place, content: Any) -> np.ndarray | None:
        """Weights (..., J) of the neighbours in the last round; None for rounds of another kind."""
        ...


def mapped(function: Callable[..., np.ndarray], first: Tree, *others: Tree) -> Tree:
    """The function of the arrays of one or several trees of named tuples, array by array."""
    if isinstance(first, tuple):
        pairs = zip(first, *(cast(tuple, other) for other in others), strict=True)
        return type(first)(*(mapped(function, *fields) for fields in pairs))
    return cast(Tree, function(first, *others))


class Published(NamedTuple):
    """Beliefs that lanes last sent, predicted to the present; `known` (...) where they exist."""

    belief: Gaussian
    known: np.ndarray

    def moved(self, carried: Carried) -> "Published":
        """At this step; what could not be carried is forgotten."""
        return Published(
            where(carried.sound, carried.beliefs, self.belief), self.known & carried.sound
        )

    def sent(self, belief: Gaussian, sends: np.ndarray) -> "Published":
        """After lanes `sends` (...) have sent their belief."""
        return Published(where(sends, belief, self.belief), self.known | sends)

    def bid(self, belief: Gaussian, trigger: float) -> np.ndarray:
        """How far beliefs have moved since they were published (`bids.bid_for_change`)."""
        if not self.known.any():
            return np.full(self.known.shape, FIRST_BID)
        return np.where(self.known, bid_for_change(belief, self.belief, trigger), FIRST_BID)


def nothing_published(prior: Gaussian) -> Published:
    """Before lanes have sent; their priors fill the places."""
    return Published(prior, np.zeros(prior.mean.shape[:-1], dtype=bool))


def older(ages: np.ndarray) -> np.ndarray:
    """Ages one cycle later; -1 is never."""
    return np.where(ages < 0, -1, ages + 1)
