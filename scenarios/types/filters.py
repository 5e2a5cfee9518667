"""Filters as values: how a node computes its estimate from readings, with the filter's options."""

from typing import Annotated, Literal, get_args

from concord.features.sets.filters.multipliers import ACCURACY
from concord.filters.filter import Filter
from concord.scenarios.types.option import USER, Choice, Option, name_of
from concord.scenarios.user.values import FromFile, is_source_name, kept_source, source_of


class FilterBase(Choice, frozen=True, kw_only=True):
    """A filter of the nodes."""


class UnscentedFilter(FilterBase, frozen=True, kw_only=True, tag="ukf"):
    """Unscented Kalman filter, with the sigma points of the scenario."""


class CubatureFilter(FilterBase, frozen=True, kw_only=True, tag="ckf"):
    """Cubature Kalman filter: sigma points of equal positive weights."""


class SquareRootUnscented(FilterBase, frozen=True, kw_only=True, tag="srukf"):
    """Unscented Kalman filter in square-root form: no difference of covariances."""


class SquareRootCubature(FilterBase, frozen=True, kw_only=True, tag="srckf"):
    """Cubature Kalman filter in square-root form: no difference of covariances."""


class TangentFilter(FilterBase, frozen=True, kw_only=True, tag="ekf"):
    """Extended Kalman filter, with Jacobians by central differences."""


class LinearFilter(FilterBase, frozen=True, kw_only=True, tag="kf"):
    """Kalman filter, for plants and sensors that are linear; takes a singular covariance."""


class PassesFilter(FilterBase, frozen=True, kw_only=True):
    """A filter that takes a reading in several passes."""

    iterations: Annotated[
        int, Option("Most passes of an update, for beliefs that do not settle before.", at_least=2)
    ] = 20


class PosteriorLinearisation(PassesFilter, frozen=True, kw_only=True, tag="iplf"):
    """Iterated posterior linearisation: the ukf, linearised where the reading leads."""


class IteratedTangentFilter(PassesFilter, frozen=True, kw_only=True, tag="iekf"):
    """Iterated extended Kalman filter: the ekf, linearised where the reading leads."""


class InteractingMultipleModels(FilterBase, frozen=True, kw_only=True, tag="imm"):
    """Interacting multiple models: the ukf of a straight course and that of a turn."""

    change: Annotated[
        float,
        Option("Probability that a straight course or a turn ends within a step.", above=0,
               below=1),
    ] = 0.05  # fmt: skip
    turn_rate_std: Annotated[
        float,
        Option("Standard deviation of the rate with which a turn begins.", unit="rad/s", above=0),
    ] = 0.1


class MaximumCorrentropy(PassesFilter, frozen=True, kw_only=True, tag="mcukf"):
    """Maximum-correntropy unscented Kalman filter: outliers lose their weight."""

    bandwidth: Annotated[
        float,
        Option("Error from which a reading loses weight, in standard deviations.", above=0),
    ] = 3.0


class NoiseLearningFilter(FilterBase, frozen=True, kw_only=True):
    """A filter that learns the noise of its own sensor."""

    least_noise: Annotated[
        float,
        Option("Least learnt variance of a channel, as a part of that of its data sheet.", above=0,
               at_most=1),
    ] = 1.0  # fmt: skip
    most_noise: Annotated[
        float,
        Option("Largest learnt variance of a channel, as a multiple of that of its data sheet.",
               at_least=1),
    ] = 1e4  # fmt: skip


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


class ReceiverBase(FilterBase, frozen=True, kw_only=True):
    """A filter that only the receiver of a measurement bus can use."""


class RecommendedFilter(ReceiverBase, frozen=True, kw_only=True, tag="recommended"):
    """Unscented filter with exact moments of noise that grows with the state (meng2025)."""


class PrintedFilter(ReceiverBase, frozen=True, kw_only=True, tag="paper-literal"):
    """The filter of Meng et al. (2025) as printed, with a pseudo-inverse; worse than no reading."""


class RepairedFilter(ReceiverBase, frozen=True, kw_only=True, tag="paper-literal-R"):
    """The filter of Meng et al. (2025) as printed, with measurement noise on every row."""


class SetFilter(ReceiverBase, frozen=True, kw_only=True):
    """Sets that hold the truth for certain, at the receiver of a measurement bus."""

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


class ConstrainedReceiver(ZonotopeReceiver, frozen=True, kw_only=True, tag="constrained-zonotope"):
    """Zonotopes that readings cut exactly (Scott et al. 2016); needs bounded noise and scipy."""

    constraints: Annotated[
        int, Option("Readings that cut a zonotope exactly: the newest.", at_least=0, at_most=100)
    ] = 10


class UserFilter(FromFile, FilterBase, frozen=True, kw_only=True, tag=USER):
    """A filter of your own, from a Python file: an object with `predict` and `update`."""

    source: str = ""
    digest: str = ""

    @classmethod
    def made_of(cls, asked: object) -> "UserFilter | None":
        """A filter by the name of its file, or as an object."""
        if is_source_name(asked):
            source = source_of(str(asked))
        elif isinstance(asked, Filter):
            source = kept_source(asked)
        else:
            return None
        return cls(source=source.name, digest=source.digest)


FilterChoice = (
    UnscentedFilter
    | CubatureFilter
    | SquareRootUnscented
    | SquareRootCubature
    | TangentFilter
    | LinearFilter
    | PosteriorLinearisation
    | IteratedTangentFilter
    | InteractingMultipleModels
    | MaximumCorrentropy
    | AdaptiveUnscented
    | FuzzyUnscented
    | AdaptiveDualLayer
    | RecommendedFilter
    | PrintedFilter
    | RepairedFilter
    | EllipsoidReceiver
    | ZonotopeReceiver
    | ConstrainedReceiver
    | UserFilter
)
FILTER_SUMMARIES = {
    name_of(one): one.summary()
    for one in get_args(FilterChoice)
    if not issubclass(one, ReceiverBase | UserFilter)
}
