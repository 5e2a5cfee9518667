"""Fusion rules as values: which rule the nodes use, with the rule's own options."""

from typing import Annotated, ClassVar, Literal

from concord.scenarios.types.holds import (
    BeliefHold,
    Decayed,
    Fading,
    Hold,
    TrimmedHold,
)
from concord.scenarios.types.option import USER, Choice, Option
from concord.scenarios.user.values import FromFile, builder_source

Number = Literal["float64", "float32", "float16"]
NUMBER = Option(
    "Format of numbers on the wire; float16 is two bytes each, for shares of beliefs, whose "
    "covariance is enlarged by what is lost.",
    first=True,
    cure="two bytes a number are for shares with a covariance, which what is lost enlarges",
)
HOLD = Option("Use of the last share of a silent neighbour.", group="rule", is_setting=True)


class FusionRule(Choice, frozen=True, kw_only=True):
    """A fusion rule of the network.

    `unavailable` says why only some scenarios have the rule; empty for a rule of all.
    """

    unavailable: ClassVar[str] = ""


class NumberRule(FusionRule, frozen=True, kw_only=True):
    """A rule whose shares are numbers of one format."""

    number: Annotated[Number, NUMBER] = "float64"


class AverageRule(NumberRule, frozen=True, kw_only=True):
    """A rule that averages beliefs, fresh ones and held ones."""

    hold: Annotated[BeliefHold, HOLD] = Decayed()


class CovarianceIntersection(AverageRule, frozen=True, kw_only=True, tag="ci"):
    """Covariance intersection: consistent for any correlation, never less tight than wac."""


class SharpCovarianceIntersection(AverageRule, frozen=True, kw_only=True, tag="sharp-ci"):
    """ci with weights that go to the sharper beliefs of a neighbourhood: less error and caution."""


class WeightedAverage(AverageRule, frozen=True, kw_only=True, tag="wac"):
    """Weighted average of means and covariances (the paper's): no inverse, may diverge."""


class TrimmedCovarianceIntersection(NumberRule, frozen=True, kw_only=True, tag="trimmed-ci"):
    """ci that --liars of a node's neighbours cannot drag away; needs twice as many neighbours."""

    hold: Annotated[TrimmedHold, HOLD] = Fading()
    liars: Annotated[
        int, Option("How many of a node's neighbours may say anything at all.", at_least=0)
    ] = 1


class HybridConsensus(NumberRule, frozen=True, kw_only=True, tag="hcmci"):
    """Consensus on prior and novelty, safe gain: consistent, near centralised with more rounds."""


class InformationConsensus(NumberRule, frozen=True, kw_only=True, tag="icf"):
    """Information-weighted consensus in the bytes of ci: overconfident before rounds converge."""


class DiffusionRule(NumberRule, frozen=True, kw_only=True, tag="diffusion"):
    """Readings of the neighbours, then averaged means; covariance not fused: not consistent."""

    number: Annotated[Literal["float64", "float32"], NUMBER] = "float64"


class KalmanConsensus(NumberRule, frozen=True, kw_only=True, tag="kcf"):
    """Readings of the neighbours, then a pull to their means: not consistent, takes no weights."""

    number: Annotated[Literal["float64", "float32"], NUMBER] = "float64"


class LocalRule(NumberRule, frozen=True, kw_only=True, tag="local"):
    """Every node alone: publishes, but fuses nothing."""


class CentralisedRule(NumberRule, frozen=True, kw_only=True, tag="centralised"):
    """All readings at every node: the optimum; complete graph, full schedule, one round."""

    number: Annotated[Literal["float64", "float32"], NUMBER] = "float64"


LEAST_WINDOW_STEPS = 32
"""A window costs neither bytes nor time of the bus, so it is longer than most networks need."""


class FloodingRule(FusionRule, frozen=True, kw_only=True):
    """A rule whose shares are labelled measurements.

    `checkpoint_number` is the type code of numbers in the beliefs that begin a window.
    """

    checkpoint_number: ClassVar[str] = "<f4"

    window_steps: Annotated[
        int | None,
        Option("How late a record may come; the latency of the schedule when left out.",
               unit="steps"),
    ] = None  # fmt: skip
    digest_steps: Annotated[
        int | None,
        Option("Say in each share what is held of so many steps, so that what links lose is sent "
               "again; 10 at most where links lose frames when left out.", unit="steps",
               at_least=0),
    ] = None  # fmt: skip
    repeat_above: Annotated[
        float,
        Option("Repeat an unconfirmed record from this expected number of neighbours without it; 0 "
               "repeats all.", at_least=0),
    ] = 0.12  # fmt: skip
    repeat_bytes: Annotated[
        int,
        Option("Most bytes of repeated records in a share.", unit="bytes", at_least=0,
               at_most=254),
    ] = 48  # fmt: skip
    payload_bytes: Annotated[
        int | None,
        Option("Longest payload of a frame; when left out 254, or where nodes own static slots "
               "what a step's records need.", unit="bytes", at_least=16, at_most=254, even=True),
    ] = None  # fmt: skip
    relay: Annotated[
        bool,
        Option("Compose each share at its slot, with what earlier slots of the cycle brought."),
    ] = False
    latch_delay_us: Annotated[
        float,
        Option("Time of a host to relay, from the last bit of a frame to the first of its own.",
               unit="us", at_least=0, needs="relay"),
    ] = 5.0  # fmt: skip


class MeasurementFlooding(FloodingRule, frozen=True, kw_only=True, tag="labelled"):
    """Measurements with labels, each counted once: near centralised in a fraction of the bytes."""

    gate_probability: Annotated[
        float,
        Option("Do not pass on own readings that are less likely than this; 0 passes all on.",
               at_least=0, below=1),
    ] = 0.0  # fmt: skip
    withhold_below: Annotated[
        float,
        Option("Do not pass on own readings of a step that change the node's prediction by a "
               "Kullback-Leibler divergence below this; 0 passes all on.", unit="nats",
               at_least=0),
    ] = 0.0  # fmt: skip
    record_number: Annotated[
        Literal["int12", "int16", "float32", "float64"], Option("Format of readings on the wire.")
    ] = "int16"
    smooth_steps: Annotated[
        int,
        Option("Also estimate the states of up to so many steps ago, with all records since.",
               unit="steps", at_least=0),
    ] = 0  # fmt: skip


class UserRule(FromFile, AverageRule, frozen=True, kw_only=True, tag=USER):
    """A rule of your own, from a Python file: `rule(beliefs, weights) -> belief`."""

    source: str = ""
    digest: str = ""

    @classmethod
    def made_of(cls, asked: object) -> "UserRule | None":
        """A rule by the name of its file, or as a function."""
        found = builder_source(asked)
        return found and cls(source=found.name, digest=found.digest)


def hold_of(rule: FusionRule) -> Hold | None:
    """The hold policy of a rule; None for one that uses only fresh shares."""
    held: Hold | None = getattr(rule, "hold", None)
    return held


def latch_delay_of(rule: FusionRule) -> float | None:
    """Return the time that a host needs to relay, in us; None for a rule that does not relay."""
    if isinstance(rule, FloodingRule) and rule.relay:
        return rule.latch_delay_us
    return None


def number_of(rule: FusionRule) -> str:
    """The format of numbers in a share; that of its readings for a rule that floods these."""
    return str(getattr(rule, "number", None) or getattr(rule, "record_number", "float64"))


def smoothing_lags(rule: FusionRule) -> int:
    """Return how many states a node estimates, that of the step itself included; 0 for none."""
    steps = rule.smooth_steps if isinstance(rule, MeasurementFlooding) else 0
    return steps + 1 if steps else 0
