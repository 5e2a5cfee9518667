"""Options of a measurement bus: plants, the rule of its receiver, its filter and its slots."""

from typing import Annotated, ClassVar

from concord.scenarios.types.filters import FilterBase
from concord.scenarios.types.option import Choice, Option
from concord.scenarios.types.plants import SensedPlantChoice
from concord.scenarios.types.rules import HOLD, NumberRule
from concord.scenarios.types.schedules import BusSchedule

RECEIVER_ONLY = (
    "it is for the receiver of a measurement bus, as --scenario meng2025 or liu2021 has one; leave "
    "it out"
)


class StochasticReceiver(SensedPlantChoice, frozen=True, kw_only=True, tag="meng2025"):
    """Six sensors share one slot per step to an estimator (Meng et al. 2025)."""


class StochasticNetwork(SensedPlantChoice, frozen=True, kw_only=True, tag="meng2025-network"):
    """A network of estimators as in meng2025, each behind a measurement bus of its own."""

    static_slots: Annotated[
        int, Option("Sensors of a measurement bus that own a slot each.", at_least=0)
    ] = 4


class ZeroOrder(Choice, frozen=True, kw_only=True, tag="zero-order"):
    """A silent sensor is taken to measure what it measured last."""


class ZeroInput(Choice, frozen=True, kw_only=True, tag="zero-input"):
    """A silent sensor is taken to measure zero."""


SensorHold = ZeroOrder | ZeroInput


class Reception(NumberRule, frozen=True, kw_only=True, tag="reception"):
    """One node estimates what the others send over a measurement bus (meng2025, liu2021)."""

    unavailable: ClassVar[str] = (
        "one node estimates from a measurement bus, which a scenario such as meng2025 or liu2021 "
        "has"
    )
    hold: Annotated[SensorHold, HOLD] = ZeroOrder()
    bid_weights: Annotated[
        str,
        Option('Weights of the sensors\' bids, "1 1 2 1"; several rows, apart by ";", take turns '
               "step by step. Those of the scenario when left out."),
    ] = ""  # fmt: skip


class RecommendedFilter(FilterBase, frozen=True, kw_only=True, tag="recommended"):
    """Unscented filter with exact moments of noise that grows with the state (meng2025)."""

    unavailable: ClassVar[str] = RECEIVER_ONLY


class SensorSlots(BusSchedule, frozen=True, kw_only=True, tag="flexray"):
    """Some sensors of a measurement bus own a slot each, the others contend for one (meng2025)."""

    static_slots: Annotated[
        int, Option("Sensors of a measurement bus that own a slot each.", at_least=0)
    ] = 4


class SilentSchedule(BusSchedule, frozen=True, kw_only=True, tag="none"):
    """No sensor of a measurement bus ever sends (meng2025)."""
