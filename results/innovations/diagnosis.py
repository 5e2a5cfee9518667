"""Diagnosis of the sensors and the model of a run, from its innovations.

The channels of the filter that hears everything are tested, as its innovations do not depend on the
fusion rule. Each of the three tests of each channel may be wrong by chance, so their thresholds are
divided by their number (Bonferroni): of `1 / FALSE_ALARMS` runs whose model is right, one is
accused. A deviation within a margin is left out, however sure: models are approximations.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from concord.results.innovations.channel_test import LEAST_UPDATES, ChannelTest

FALSE_ALARMS = 0.001
MEAN_MARGIN, SPREAD_MARGIN, CORRELATION_MARGIN = 0.1, 1.2, 0.1
"""Least deviations: of a mean in standard deviations, of a variance as a ratio either way, and of a
correlation."""


_FEWEST_FAR, _MOST_FAR = 3, 0.25
"""Least number of outliers that are no chance, and the share beyond which they are the noise."""
_SURE, _LEANS = 2.0, 0.01
"""Standard deviations of a correlation beyond which its sign counts, of a channel that deviates; p
value of a variance below which its side counts, of a channel that is not white."""


class Cause(Enum):
    """Cause of innovations that deviate."""

    NONE = "consistent"
    UNKNOWN = "unknown"
    OFFSET = "offset of a sensor"
    NOISE_TOO_SMALL = "noise of a sensor too small"
    OUTLIERS = "outliers of a sensor"
    NOISE_TOO_LARGE = "noise of a sensor too large"
    COLOURED = "coloured noise of a sensor"
    ALL_NOISE_TOO_SMALL = "noise of all sensors too small"
    ALL_NOISE_TOO_LARGE = "noise of all sensors too large"
    PROCESS_NOISE_TOO_SMALL = "process noise too small"
    PROCESS_NOISE_TOO_LARGE = "process noise too large"
    MODEL = "model error"


class Channel(NamedTuple):
    """A channel of a node's reading; `name` and `unit` are those of its sensor."""

    node: int
    reading: int
    entry: int
    name: str
    unit: str


class Diagnosis(NamedTuple):
    """The cause, the channel that shows it most, and how many others show a deviation too.

    `shifted` is the channel with the largest offset, where the cause is another.
    """

    cause: Cause
    channel: Channel | None = None
    test: ChannelTest | None = None
    others: int = 0
    shifted: tuple[Channel, ChannelTest] | None = None


class _Tested(NamedTuple):
    channel: Channel
    test: ChannelTest
    shifted: bool
    spread: bool
    coloured: bool

    @property
    def deviates(self) -> bool:
        return self.shifted or self.spread or self.coloured

    @property
    def effect(self) -> float:
        """How far the variance is off, as a logarithm."""
        return _log_spread(self.test)

    @property
    def points_to_model(self) -> bool:
        """Whether the correlation has the sign of a wrong process noise.

        A gain that is too small leaves innovations of positive correlation, one that is too large
        of negative. Process noise that is too small makes gain and covariance too small; sensor
        noise that is too small makes the gain too large and the covariance too small.
        """
        correlation, margin = self.test.correlation, np.log(SPREAD_MARGIN)
        sure = self.coloured or abs(correlation) * np.sqrt(self.test.updates) > _SURE
        if not (sure and (self.spread or self.coloured)):
            return False
        return abs(self.effect) < margin or (self.effect > 0) == (correlation > 0)


def diagnose(channels: Sequence[tuple[Channel, ChannelTest]]) -> Diagnosis:
    """The cause that the tests of all channels agree on best."""
    known = [one for one in channels if one[1].updates >= LEAST_UPDATES]
    if not known:
        return Diagnosis(Cause.UNKNOWN)
    threshold = FALSE_ALARMS / (3 * len(known))
    tested = [_judged(channel, test, threshold) for channel, test in known]
    deviating = [one for one in tested if one.deviates]
    if not deviating:
        return Diagnosis(Cause.NONE)
    worst = max(deviating, key=_deviation)
    if worst.spread and _by_outliers(worst.test):
        # They disturb the innovations that follow, and those of other channels.
        return _found(Cause.OUTLIERS, worst, deviating)
    model = [one for one in tested if one.points_to_model]
    alone = len(tested) == 1
    unsure = [one for one in tested if one.spread or one.coloured]
    if alone or (model and 2 * len(model) >= len(unsure) and _explains(model, deviating)):
        return _of_all(model or deviating, deviating, alone)
    spread = [one for one in tested if one.spread and not one.points_to_model]
    if _shared(spread) and 2 * len(spread) > len(tested) and _alike(spread):
        return _of_all(spread, deviating, alone)
    shifted = [one for one in tested if one.shifted]
    if _shared(shifted) and 2 * len(shifted) > len(tested) and _same_way(shifted):
        worst = max(shifted, key=lambda one: abs(one.test.shift))
        return _found(Cause.MODEL, worst, deviating)
    return _of_one(deviating)


def _judged(channel: Channel, test: ChannelTest, threshold: float) -> _Tested:
    return _Tested(
        channel,
        test,
        test.p_mean < threshold and abs(test.shift) > MEAN_MARGIN,
        test.p_spread < threshold and abs(_log_spread(test)) > np.log(SPREAD_MARGIN),
        test.p_white < threshold and abs(test.correlation) > CORRELATION_MARGIN,
    )


def _log_spread(test: ChannelTest) -> float:
    # That of a series that never changes is 0.
    return float(np.log(max(test.spread, np.finfo(float).tiny)))


def _shared(some: list[_Tested]) -> bool:
    """Whether channels of several nodes are among them."""
    return len({one.channel.node for one in some}) > 1


def _alike(some: list[_Tested]) -> bool:
    """Whether variances are off the same way, and none by much more than the others."""
    effects = np.array([one.effect for one in some])
    largest = effects[np.abs(effects).argmax()]
    return bool((effects * largest > 0).all() and 2 * np.median(effects / largest) > 1)


def _same_way(some: list[_Tested]) -> bool:
    """Whether several channels have one name, and all of a name are shifted to the same side."""
    sides: dict[str, set[bool]] = {}
    for one in some:
        sides.setdefault(one.channel.name, set()).add(one.test.shift > 0)
    return len(sides) < len(some) and all(len(seen) == 1 for seen in sides.values())


def _explains(model: list[_Tested], deviating: list[_Tested]) -> bool:
    """Whether the worst of these deviates no less than any shifted channel."""
    shifted = [_deviation(one) for one in deviating if one.shifted and one not in model]
    return max(map(_deviation, model)) >= max(shifted, default=0.0)


def _of_all(some: list[_Tested], deviating: list[_Tested], alone: bool) -> Diagnosis:
    """The cause that channels of several nodes share; or of the only channel."""
    # The sign of a correlation tells the process noise from that of sensors.
    correlated = [one for one in some if one.points_to_model]
    if correlated:
        worst = max(correlated, key=lambda one: abs(one.test.correlation))
    else:
        worst = max(some, key=lambda one: abs(one.effect))
    test = worst.test
    if alone and not worst.spread and not worst.coloured:
        return _found(Cause.OFFSET, worst, deviating)
    if worst.coloured and not worst.spread and test.p_spread > _LEANS:
        of_sensor = not alone and not _shared(some)
        return _found(Cause.COLOURED if of_sensor else Cause.MODEL, worst, deviating)
    if worst.points_to_model:
        small = test.spread > 1
        cause = Cause.PROCESS_NOISE_TOO_SMALL if small else Cause.PROCESS_NOISE_TOO_LARGE
        return _found(cause, worst, deviating)
    if alone:
        return _of_one(deviating)
    cause = Cause.ALL_NOISE_TOO_SMALL if test.spread > 1 else Cause.ALL_NOISE_TOO_LARGE
    return _found(cause, worst, deviating)


def _of_one(deviating: list[_Tested]) -> Diagnosis:
    """The cause that lies in the sensor that deviates most."""
    worst = max(deviating, key=_deviation)
    test = worst.test
    if worst.shifted and test.shift**2 > abs(test.spread - 1):
        return _found(Cause.OFFSET, worst, deviating)
    if worst.spread:
        cause = Cause.NOISE_TOO_SMALL if test.spread > 1 else Cause.NOISE_TOO_LARGE
        return _found(cause, worst, deviating)
    return _found(Cause.OFFSET if worst.shifted else Cause.COLOURED, worst, deviating)


def _by_outliers(test: ChannelTest) -> bool:
    """Whether a few far innovations make up most of what the variance is above 1."""
    few = _FEWEST_FAR <= test.far < _MOST_FAR * test.updates
    return few and test.spread > 1 and test.spread - 1 > 2 * (test.core - 1)


def _deviation(one: _Tested) -> float:
    """How far the figures that deviate are off, in units that compare."""
    test = one.test
    return (
        one.shifted * test.shift**2
        + one.spread * abs(one.effect)
        + one.coloured * test.correlation**2
    )


def _found(cause: Cause, worst: _Tested, deviating: list[_Tested]) -> Diagnosis:
    others = len(deviating) - worst.deviates
    shifted = [(one.channel, one.test) for one in deviating if one.shifted]
    besides = None
    if shifted and cause not in (Cause.OFFSET, Cause.MODEL):
        besides = max(shifted, key=lambda pair: abs(pair[1].shift))
    return Diagnosis(cause, worst.channel, worst.test, others, besides)
