"""Figures of innovations from which tests build verdicts."""

import numpy as np

from concord.results.figures.intervals import Interval
from concord.results.innovations.channel_test import ChannelTest
from concord.results.innovations.diagnosis import Cause, Channel, Diagnosis
from concord.results.verdict.findings import Finding
from concord.results.verdict.honesty import honesty
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Explanation
from tests.experiments.support import scenario

FITTING = Interval(1.0, 0.9, 1.1)
UNKNOWN = Interval(np.nan, np.nan, np.nan)
YAW = Channel(2, 0, 0, "yaw rate", "rad/s")
OFF = ChannelTest(
    updates=200,
    nis=Interval(14.0, 12.0, 16.0),
    mean=Interval(0.02, 0.018, 0.022),
    shift=3.0,
    spread=5.0,
    correlation=0.4,
    p_mean=0.0,
    p_spread=0.0,
    p_white=0.0,
)
TOO_SMALL = OFF._replace(nis=Interval(0.5, 0.4, 0.6), spread=0.5)
UNDER = Interval(0.5, 0.4, 0.6)
OVER = Interval(2.9, 2.3, 3.7)


def verdict(
    of: Scenario,
    diagnosis: Diagnosis,
    nis: Interval,
    anees: Interval,
    explained: Explanation = Explanation(),  # noqa: B008  a tuple, which nothing changes
) -> Finding:
    """The finding on honesty, by default of a plant that tells nothing more."""
    return honesty(of, diagnosis, nis, anees, explained, "--steps 99")


def said(cause: Cause, others: int = 0, name: str = "oscillator", **options) -> str:
    diagnosis = Diagnosis(cause, YAW, OFF, others)
    return verdict(scenario(name, **options), diagnosis, FITTING, FITTING).said
