"""Verdicts from figures alone: which cause, which level and which words follow from numbers."""

import numpy as np
import pytest

from concord.results.figures.intervals import Interval
from concord.results.innovations.channel_test import ChannelTest
from concord.results.innovations.diagnosis import Cause, Channel, Diagnosis
from concord.results.outages import NodeOutage
from concord.results.verdict.findings import Finding
from concord.results.verdict.honesty import honesty
from concord.scenarios.scenario_definition import Explanation
from tests.experiments.support import scenario

ASKED = scenario(rule="ci")
NOTHING = Explanation()
RIGHT = Interval(1.02, 0.95, 1.08)
LOW, HIGH, UNKNOWN = Interval(0.5, 0.4, 0.6), Interval(2.0, 1.5, 2.5), Interval(*[np.nan] * 3)
YAW = Channel(2, 0, 0, "yaw rate", "rad/s")


def told(
    diagnosis: Diagnosis, nis: Interval = RIGHT, anees: Interval = RIGHT,
    explained: Explanation = NOTHING, best: Interval = UNKNOWN,
) -> Finding:  # fmt: skip
    return honesty(ASKED, diagnosis, nis, anees, explained, "--steps 77", best)


@pytest.mark.parametrize(
    ("nis", "anees", "level", "cause", "words"),
    [
        (RIGHT, RIGHT, "WORKS", "consistent", "(NIS 1.02, ANEES 1.02 where 1 is right)"),
        (RIGHT, HIGH, "CHECK", "overconfident", "rule ci claims too much (ANEES 2 where"),
        (HIGH, RIGHT, "CHECK", "overconfident", "claims too much (NIS 2 where"),
        (HIGH, UNKNOWN, "CHECK", "overconfident", "(NIS 2 where 1 is right)"),
        (RIGHT, LOW, "WORKS", "cautious", "errors 1.41 x those they make (ANEES 0.5"),
        (RIGHT, Interval(1.0, 0.05, 20), "CHECK", "too short", "ANEES 1 may be 0.05 to 20"),
        (RIGHT, Interval(1.3, np.nan, np.nan), "CHECK", "too short", "steps to judge ANEES 1.3"),
        (RIGHT, UNKNOWN, "WORKS", "consistent", "(NIS 1.02 where 1 is right)"),
        # Sure, yet within the margin of ten per cent.
        (RIGHT, Interval(1.09, 1.05, 1.12), "WORKS", "consistent", "ANEES 1.09"),
        # Beyond the margin, yet its interval holds 1.
        (RIGHT, Interval(1.5, 0.8, 2.2), "WORKS", "consistent", "ANEES 1.5"),
    ],
)
def test_estimates_are_judged_by_their_intervals_about_one(
    nis: Interval, anees: Interval, level: str, cause: str, words: str
):
    found = told(Diagnosis(Cause.NONE), nis, anees)
    assert (found.level, found.cause) == (level, cause)
    assert found.said.startswith(f"{cause}: ") and words in found.said
    assert found.cure == ("use --steps 77" if cause == "too short" else "")
    assert (found.node, found.sensor) == (None, None)


def channel_test(nis: Interval, shift: float = 0.0, mean: float = 0.0) -> ChannelTest:
    return ChannelTest(
        40,
        nis,
        Interval(mean, mean - 0.125, mean + 0.125),
        shift,
        1.5,
        -0.25,
        0.5,
        0.5,
        0.5,
        7,
        1.125,
    )


@pytest.mark.parametrize(
    ("cause", "test", "lead", "words"),
    [
        (
            Cause.OFFSET,
            channel_test(RIGHT, 0.3, 4.0),
            "biased",
            ["reads 4 rad/s (95 %: 3.9 to 4.1)"],
        ),
        (Cause.NOISE_TOO_SMALL, channel_test(HIGH), "overconfident", ["raise R, or let nodes"]),
        (
            Cause.NOISE_TOO_SMALL,
            channel_test(HIGH, 0.1, 0.5),
            "overconfident",
            ["by 0.5 rad/s"],
        ),
        (
            Cause.OUTLIERS,
            channel_test(HIGH),
            "overconfident",
            ["7 of its 40", "of 1.1 where"],
        ),
        (Cause.NOISE_TOO_LARGE, channel_test(LOW), "underconfident", ["lower R"]),
        (Cause.COLOURED, channel_test(RIGHT), "coloured", ["correlate by -0.25", "not white"]),
        (Cause.ALL_NOISE_TOO_SMALL, channel_test(HIGH), "overconfident", ["alike", "raise R"]),
        (Cause.ALL_NOISE_TOO_LARGE, channel_test(LOW), "underconfident", ["alike", "lower R"]),
        (
            Cause.PROCESS_NOISE_TOO_SMALL,
            channel_test(HIGH),
            "overconfident",
            ["raise Q", "white"],
        ),
        (
            Cause.PROCESS_NOISE_TOO_LARGE,
            channel_test(LOW),
            "underconfident",
            ["large; lower it"],
        ),
        (Cause.MODEL, channel_test(HIGH), "overconfident", ["does not move as the readings do"]),
    ],
)
def test_a_cause_in_a_channel_is_named_with_its_place_and_its_figures(
    cause: Cause, test: ChannelTest, lead: str, words: list[str]
):
    found = told(Diagnosis(cause, YAW, test))
    assert (found.cause, found.level) == (cause.value, "CHECK")
    assert (found.node, found.sensor) == (2, "yaw rate")
    assert found.said.startswith(f"{lead}: NIS of node 2's yaw rate is {test.nis.value:.3g} where")
    assert all(one in found.said for one in words), found.said
    beside = told(Diagnosis(cause, YAW, test, others=3)).said
    of_one = cause.name in ("OFFSET", "NOISE_TOO_SMALL", "OUTLIERS", "NOISE_TOO_LARGE", "COLOURED")
    assert ("3 more channels deviate, less so" in beside) == of_one
    assert ("1 more channel deviates" in told(Diagnosis(cause, YAW, test, 1)).said) == of_one


def test_errors_of_estimates_weigh_more_than_innovations():
    small = Diagnosis(Cause.NOISE_TOO_LARGE, YAW, channel_test(LOW))
    found = told(small, anees=HIGH)
    assert found.cause == "overconfident" and "innovations alone would say underconf" in found.said
    known = Explanation(errors="errors are known", anees=(1.0, 0.9, 1.1))
    assert told(small, explained=known).said.startswith("consistent: errors are known")
    unknown = known._replace(anees=(1.0, np.nan, np.nan))
    assert told(small, explained=unknown).cause == "undecided"
    large = Diagnosis(Cause.NOISE_TOO_SMALL, YAW, channel_test(HIGH))
    assert told(large, explained=known).said.endswith("; errors are known")


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        ((3,), "node 3 was"),
        ((2, 3), "nodes 2 and 3 were"),
        ((1, 2, 3, 5, 8, 9), "nodes 1, 2, 3, 5, 8 and 9 were"),
        ((1, 2, 3, 5, 8, 9, 11), "nodes 1, 2, 3, 5, ... (7 nodes) were"),
    ],
)
def test_outages_are_told_with_their_nodes_steps_and_reason(nodes: tuple[int, ...], words: str):
    asked = NodeOutage(nodes, 40, 60, True).in_words()
    assert asked == f"{words} out from step 40 to step 59, as asked"
    lost = NodeOutage(nodes, 7, None, False).in_words()
    assert lost == f"{words} out from step 7 to the end, lost: nothing asked for it"
