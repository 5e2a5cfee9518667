"""Filters as values: how a node computes its estimate from readings, with the filter's options."""

from typing import Annotated, ClassVar

from concord.scenarios.types.option import USER, Choice, Option
from concord.scenarios.user.values import FromFile, is_source_name, kept_source, source_of


class FilterBase(Choice, frozen=True, kw_only=True):
    """A filter of the nodes.

    `unavailable` says why only some scenarios have the filter; empty for a filter of all.
    `set_valued` filters estimate sets that hold the truth for certain. Beliefs of a filter that is
    not `in_two_bytes` need longer numbers on the wire.
    """

    unavailable: ClassVar[str] = ""
    set_valued: ClassVar[bool] = False
    in_two_bytes: ClassVar[bool] = True


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

    in_two_bytes: ClassVar[bool] = False
    change: Annotated[
        float,
        Option("Probability that a straight course or a turn ends within a step.", above=0,
               below=1),
    ] = 0.05  # fmt: skip
    turn_rate_std: Annotated[
        float,
        Option("Standard deviation of the rate with which a turn begins.", unit="rad/s", above=0),
    ] = 0.1


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


class UserFilter(FromFile, FilterBase, frozen=True, kw_only=True, tag=USER):
    """A filter of your own, from a Python file: an object with `predict` and `update`."""

    source: str = ""
    digest: str = ""

    @classmethod
    def made_of(cls, asked: object) -> "UserFilter | None":
        """A filter by the name of its file, or as an object."""
        # Only here: the options of a filter load without its mathematics.
        from concord.filters.filter import Filter

        if is_source_name(asked):
            source = source_of(str(asked))
        elif isinstance(asked, Filter):
            source = kept_source(asked)
        else:
            return None
        return cls(source=source.name, digest=source.digest)
