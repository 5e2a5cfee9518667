"""A node that learns how noisy its own sensors are, whatever rule it fuses by.

The rule wraps the estimator of another rule. Before a step it passes on a sensor with the noise
learnt so far. After the own readings it learns from their residual and spread under the belief
(Sage-Husa, R alone, in residual form). The learnt noise is part of the node's content and never
travels.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, NamedTuple

import numpy as np

from concord.filters.adaptive import sage_husa
from concord.filters.adaptive.sage_husa import NoiseEstimate
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule
from concord.nodes.estimator import Content, Estimator, Share
from concord.nodes.messages import Measured, from_wire
from concord.nodes.rules.local_filter import Sensor


class Learnt(NamedTuple, Generic[Content]):
    """The content of the rule's estimator, and the noise learnt; None before the first reading."""

    content: Content
    noise: NoiseEstimate | None


class AdaptedSensor(NamedTuple):
    """A sensor that believes in the noise learnt instead of its data sheet's."""

    sensor: Sensor
    noise: NoiseEstimate

    @property
    def gate(self) -> float | None:
        """Return the value of the wrapped sensor."""
        return self.sensor.gate

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return the value of the wrapped sensor."""
        return self.sensor.measure(state, step)

    def residual(self, value: np.ndarray, predicted: np.ndarray, /) -> np.ndarray:
        """Return the value of the wrapped sensor."""
        return self.sensor.residual(value, predicted)

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The sensor's value (m,), and the covariance (m, m) learnt."""
        return self.sensor.interpret(delivered)[0], self.noise.cov


@dataclass(frozen=True)
class AdaptiveNoise(Generic[Content, Share]):
    """The estimator `rule`, a dataclass with a field `sensor`, with noise that is learnt.

    The sensor's channels must be independent and of constant noise, as far as it knows.
    """

    rule: Estimator[Content, Share]
    sensor: Sensor
    points: SigmaPointRule

    @property
    def share_bytes(self) -> int:
        """Delegate to the wrapped rule."""
        return self.rule.share_bytes

    def start(self) -> Learnt[Content]:
        """Nothing learnt yet."""
        return Learnt(self.rule.start(), None)

    def begin_step(
        self, content: Learnt[Content], measured: Measured
    ) -> tuple[Learnt[Content], tuple[str, ...]]:
        """Take the readings with the noise learnt so far, then learn from them."""
        readings = [r for r in from_wire(measured.readings) if not np.isnan(r).all()]
        noise = content.noise
        if noise is None and readings:
            noise = declared_noise(self.sensor, readings[0])
        rule = self.rule
        if noise is not None:
            known: Any = rule  # a dataclass, which a protocol cannot say
            rule = replace(known, sensor=AdaptedSensor(self.sensor, noise))
        inner, failures = rule.begin_step(content.content, measured)
        belief = rule.belief(inner)
        for reading in readings:
            assert noise is not None, "there was a reading"
            noise = learn(noise, belief, reading, self.sensor, self.points, measured.step)
        return Learnt(inner, noise), failures

    def bid(self, content: Learnt[Content]) -> int | None:
        """Delegate to the wrapped rule."""
        return self.rule.bid(content.content)

    def compose(self, content: Learnt[Content]) -> tuple[Learnt[Content], bytes]:
        """Delegate to the wrapped rule."""
        inner, body = self.rule.compose(content.content)
        return content._replace(content=inner), body

    def accept(self, body: bytes) -> Share:
        """Delegate to the wrapped rule."""
        return self.rule.accept(body)

    def fuse(
        self, content: Learnt[Content], shares: tuple[Share | None, ...]
    ) -> tuple[Learnt[Content], tuple[str, ...]]:
        """Delegate to the wrapped rule."""
        inner, failures = self.rule.fuse(content.content, shares)
        return content._replace(content=inner), failures

    def belief(self, content: Learnt[Content]) -> Gaussian:
        """Delegate to the wrapped rule."""
        return self.rule.belief(content.content)

    def ages(self, content: Learnt[Content]) -> np.ndarray:
        """Delegate to the wrapped rule."""
        return self.rule.ages(content.content)


def declared_noise(sensor: Sensor, reading: np.ndarray) -> NoiseEstimate:
    """Return the sensor's nominal noise at a reading (d,), before any learning."""
    return sage_husa.begin(np.diagonal(sensor.interpret(reading)[1]))


def learn(
    noise: NoiseEstimate,
    belief: Gaussian,
    reading: np.ndarray,
    sensor: Sensor,
    points: SigmaPointRule,
    step: int,
) -> NoiseEstimate:
    """The noise after one more reading (d,), which the belief has taken.

    It is never less than the sensor says: a filter whose process noise is too large follows its
    readings, and a sensor without noise is what that looks like.
    """
    value, declared = sensor.interpret(reading)
    measure = partial(sensor.measure, step=step)
    left, spread = sage_husa.unexplained(belief, value, measure, points, sensor.residual)
    bounds = sage_husa.Bounds(low=np.diagonal(declared))
    return sage_husa.adapt(noise, left, spread, bounds=bounds)
