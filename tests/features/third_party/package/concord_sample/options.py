"""The rule and the scenario as values; concord loads this module while it makes its own types."""

from concord.scenarios.types.plants import SensedPlantChoice
from concord.scenarios.types.rules import AverageRule


class Widest(AverageRule, frozen=True, kw_only=True, tag="widest"):
    """Mean of the means, with the widest covariance."""


class ShortOscillator(SensedPlantChoice, frozen=True, kw_only=True, tag="short-oscillator"):
    """The oscillator for a few steps."""
