"""Options of sets: plants under bounded noise, rules, and receivers of a measurement bus."""

from typing import Annotated, ClassVar, Literal

from concord.features.measurement_bus.options import RECEIVER_ONLY
from concord.scenarios.types.filters import FilterBase
from concord.scenarios.types.holds import Dropped, Predicted
from concord.scenarios.types.option import Option
from concord.scenarios.types.plants import ControlledPlant, SensedPlantChoice
from concord.scenarios.types.rules import HOLD, FloodingRule, NumberRule

ACCURACY = 5e-6
"""Duality gap, relative to the trace, that the search for multipliers ends at."""
SetHold = Predicted | Dropped


class UnstableBounded(ControlledPlant, frozen=True, kw_only=True, tag="liu2021-network"):
    """An unstable plant under bounded noise, for sets that hold the truth for certain."""


class BoundedReceiver(SensedPlantChoice, frozen=True, kw_only=True, tag="liu2021"):
    """Four sensors of an unstable plant under bounded noise share a slot (Liu et al. 2021)."""

    noise: Annotated[
        Literal["matched", "paper"],
        Option("Noise of the plant: matched (on its bound, as sets must expect) or paper (as "
               "printed)."),
    ] = "matched"  # fmt: skip


class SetRule(NumberRule, frozen=True, kw_only=True):
    """A rule of sets that hold the truth for certain."""

    hold: Annotated[SetHold, HOLD] = Predicted()


class EllipsoidIntersection(SetRule, frozen=True, kw_only=True, tag="ellipsoid"):
    """Ellipsoids that intersect and hold the truth for certain; needs bounded noise."""


class ZonotopeIntersection(SetRule, frozen=True, kw_only=True, tag="zonotope"):
    """ellipsoid with zonotopes: tighter prediction, wider shares; needs bounded noise."""


class EllipsoidFlooding(FloodingRule, frozen=True, kw_only=True, tag="labelled-ellipsoid"):
    """labelled with ellipsoids that hold the truth for certain; needs bounded noise."""

    # A set must hold what was sent, so its checkpoint is not rounded.
    checkpoint_number: ClassVar[str] = "<f8"
    # A set takes a reading for exact, and has no probability by which to refuse one.
    gate_probability: ClassVar[float] = 0.0
    withhold_below: ClassVar[float] = 0.0
    record_number: ClassVar[str] = "float64"
    smooth_steps: ClassVar[int] = 0


class SetFilter(FilterBase, frozen=True, kw_only=True):
    """Sets that hold the truth for certain, at the receiver of a measurement bus."""

    unavailable: ClassVar[str] = RECEIVER_ONLY
    set_valued: ClassVar[bool] = True
    losers: Annotated[
        bool,
        Option("Cut the set by what the losers of a contention cannot have measured; valid while "
               "every contender asks for every slot."),
    ] = True  # fmt: skip


class EllipsoidReceiver(SetFilter, frozen=True, kw_only=True, tag="ellipsoid"):
    """Ellipsoids behind a measurement bus that hold the truth for certain; needs bounded noise."""

    method: Annotated[
        Literal["tight", "fast-rate", "fast", "paper"],
        Option("How ellipsoids are found: tight (cut by the data once a cycle), fast-rate (in "
               "every step), paper (Liu et al. 2021, by a semidefinite programme), fast (its "
               "closed form)."),
    ] = "tight"  # fmt: skip
    accuracy: Annotated[
        float,
        Option("Duality gap, relative to the trace, at which the search for an ellipsoid ends; a "
               "larger one is faster, and the set as certain.", above=0, at_most=1),
    ] = ACCURACY  # fmt: skip


class ZonotopeReceiver(SetFilter, frozen=True, kw_only=True, tag="zonotope"):
    """Zonotopes behind a measurement bus that hold the truth for certain; needs bounded noise."""

    generators: Annotated[
        int, Option("Generators that a zonotope keeps.", at_least=2, at_most=1000)
    ] = 30
