"""Receivers of a measurement bus by the filter that a scenario names."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.entries import chosen, entries
from concord.features.measurement_bus.gaussian_receiver import GaussianReceiver, System
from concord.features.measurement_bus.measurement_bus import LosingBids, WeightsAt
from concord.features.measurement_bus.reception import Receiver
from concord.features.measurement_bus.stochastic_ukf import (
    RECOMMENDED,
    MeasurementFilter,
    on_fresh_rows,
)
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule
from concord.scenarios.filter_table.filters import build_filter
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.filters import (
    FilterBase,
    InteractingMultipleModels,
    NoiseLearningFilter,
    UserFilter,
)
from concord.scenarios.user.values import value_of


class ReceiverParts(NamedTuple):
    """Everything that a receiver is built from.

    Attributes:
        system, points: of Gaussian receivers.
        bounded: the plant with bounded noise, for sets.
        schedule, weights: of the bus, by step.
        static: l, where some sensors own a slot each and the others contend for one; else None.
        held_half_width: of the held values at first, in the ellipsoid of the paper.
        prior: mean and covariance, or shape matrix, at step 0.
        held: (m,), values held at first.
        losing_bids: as in `MeasuredSets`.
    """

    system: System
    points: SigmaPointRule
    bounded: Any | None
    schedule: Schedule
    weights: WeightsAt
    static: int | None
    held_half_width: float
    prior: Gaussian
    held: np.ndarray
    losing_bids: LosingBids | None


def _gaussian(choice: FilterBase, parts: ReceiverParts) -> Receiver:
    filter = build_filter(choice, len(parts.prior.mean), parts.points)
    fresh = on_fresh_rows(lambda _: filter)
    return GaussianReceiver(parts.system, fresh, parts.points, parts.prior)


def _recommended(choice: FilterBase, parts: ReceiverParts) -> Receiver:
    return GaussianReceiver(parts.system, RECOMMENDED, parts.points, parts.prior)


def _of_user(choice: UserFilter, parts: ReceiverParts) -> Receiver:
    value = value_of(choice.where)
    if isinstance(value, MeasurementFilter):
        return GaussianReceiver(parts.system, value, parts.points, parts.prior)
    return _gaussian(choice, parts)


class ReceiverDefinition(NamedTuple):
    """A receiver of a measurement bus.

    Attributes:
        build: (its options, its parts) -> the receiver.
        check: (scenario, whether its noise is bounded); raises ValueError where it cannot be.
        one_by_one: runs of a Monte Carlo are computed one after the other (`one_by_one.py`).
    """

    build: Callable[[Any, ReceiverParts], Receiver]
    check: Callable[[Scenario, bool], None] = lambda _scenario, _is_bounded: None
    one_by_one: bool = False


RECOMMENDED_RECEIVER = ReceiverDefinition(_recommended)


def receiver_definition(choice: FilterBase) -> ReceiverDefinition:
    """Return the receiver of a filter; filters of the nodes take what is sent and nothing else."""
    if isinstance(choice, UserFilter):
        return ReceiverDefinition(_of_user)
    if choice.name in entries("RECEIVERS"):
        found: ReceiverDefinition = chosen("RECEIVERS", choice.name)
        return found
    return ReceiverDefinition(_gaussian)


def check_receiver(scenario: Scenario, is_bounded: bool) -> None:
    """Refuse a filter that no receiver can use, and a receiver where it cannot be.

    Raises:
        ValueError: naming the receiver, what is in its way, and the cure.
    """
    choice = scenario.filter
    if isinstance(choice, NoiseLearningFilter):
        raise ValueError(
            f"--filter {choice.name}: it learns the noise of a node's own sensors, and the "
            "receiver of a measurement bus has none; use ukf or recommended"
        )
    if isinstance(choice, InteractingMultipleModels):
        raise ValueError(
            f"--filter {choice.name}: its models are a straight course and a turn, and the "
            "receiver of a measurement bus has the one of its plant; use ukf or recommended"
        )
    receiver_definition(choice).check(scenario, is_bounded)
