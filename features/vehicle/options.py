"""Options of a car and of filters that learn the noise of their sensors or resist outliers."""

from typing import Annotated, Literal

from concord.scenarios.types.filters import NoiseLearningFilter, PassesFilter
from concord.scenarios.types.option import Option
from concord.scenarios.types.plants import DATA, SensedPlantChoice


class VehicleNetwork(SensedPlantChoice, frozen=True, kw_only=True, tag="vehicle-network"):
    """A car's sensors on its FlexRay bus estimate its motion; `aukf` learns their noise."""

    car: Annotated[
        str, Option("Which car is simulated: bmw-320i, bmw-320i-soft, ford-escort or vw-vanagon.")
    ] = "bmw-320i"
    manoeuvre: Annotated[
        str, Option("Manoeuvre of the driver: double-lane-change, serpentine, ramp-steer, ...")
    ] = "serpentine"
    noise: Annotated[
        Literal["matched", "growing", "small", "outliers", "biased"],
        Option("Noise of the sensors of the car."),
    ] = "growing"
    data: Annotated[str | None, DATA] = None
    arrival: Annotated[
        Literal["stamped", "late"],
        Option("When nodes have the readings of a log: at their stamps less the delays, or as much "
               "later as the delays say (rule labelled puts them back)."),
    ] = "stamped"  # fmt: skip
    process_noise: Annotated[
        float,
        Option(
            "Standard deviations of the filters' process noise over those of the car file.",
            above=0,
        ),
    ] = 1.0
    sensor_gate: Annotated[
        float,
        Option("Do not use readings of the car's sensors that are less likely than this; 0 uses "
               "all.", at_least=0, below=1),
    ] = 0.0  # fmt: skip


class MaximumCorrentropy(PassesFilter, frozen=True, kw_only=True, tag="mcukf"):
    """Maximum-correntropy unscented Kalman filter: outliers lose their weight."""

    bandwidth: Annotated[
        float,
        Option("Error from which a reading loses weight, in standard deviations.", above=0),
    ] = 3.0


class SageHusaBase(NoiseLearningFilter, frozen=True, kw_only=True):
    """A filter that learns noise by a fading average."""

    forgetting: Annotated[
        float, Option("Weight of the past in the learnt noise.", above=0, below=1)
    ] = 0.98
    outlier_limit: Annotated[
        float,
        Option("Most that a reading counts, as a multiple of the variance learnt so far.", above=1),
    ] = 100.0


class AdaptiveUnscented(SageHusaBase, frozen=True, kw_only=True, tag="aukf"):
    """Adaptive unscented Kalman filter: learns R by Sage and Husa's fading average."""


class FuzzyUnscented(NoiseLearningFilter, frozen=True, kw_only=True, tag="faukf"):
    """Fuzzy adaptive unscented Kalman filter: learns R from the size of innovations."""

    innovations: Annotated[
        int, Option("Innovations of a channel that the filter looks back on.", at_least=2)
    ] = 30


class AdaptiveDualLayer(SageHusaBase, frozen=True, kw_only=True, tag="adlukf"):
    """Adaptive dual-layer unscented Kalman filter, each reading counted once; learns R."""
