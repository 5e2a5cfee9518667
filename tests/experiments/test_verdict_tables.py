"""Verdicts from figures alone: which cause, which level and which words follow from numbers."""

from math import exp, gamma, pi, sqrt

import numpy as np
import pytest
from scipy import integrate, stats

from concord.results.figures.intervals import Interval
from concord.results.innovations import gates as gates_module
from concord.results.innovations.channel_test import ChannelTest
from concord.results.innovations.diagnosis import Cause, Channel, Diagnosis
from concord.results.innovations.gates import accepted, mean_behind_gate
from concord.results.outages import NodeOutage
from concord.results.verdict.findings import Finding, VerdictLevel, beyond, verdict_of
from concord.results.verdict.honesty import honesty, outside_in_words, times_claimed
from concord.scenarios.innovations import Innovations
from concord.scenarios.scenario_definition import Explanation
from tests.experiments.support import scenario, small

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


def test_too_few_readings_are_no_verdict():
    found = told(Diagnosis(Cause.UNKNOWN), HIGH, HIGH)
    assert (found.level, found.cause, found.cure) == ("CHECK", "too short", "use --steps 77")


def test_an_error_that_all_sensors_share_shows_in_no_reading():
    found = told(Diagnosis(Cause.NONE), RIGHT, HIGH, best=Interval(3.0, 2.0, 4.0))
    assert (found.level, found.cause) == ("CHECK", "hidden error")
    assert "NIS 1.02" in found.said and "ANEES 3 where 1 is right" in found.said
    # It is the rule's doing where the filter that hears everything is right.
    assert told(Diagnosis(Cause.NONE), RIGHT, HIGH, best=RIGHT).cause == "overconfident"


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


def test_what_a_plant_explains_takes_the_place_of_the_cause_in_a_channel():
    explained = Explanation(cause="the road is steep", misread="the file is misread")
    large = Diagnosis(Cause.NOISE_TOO_SMALL, YAW, channel_test(HIGH))
    assert told(large, explained=explained).said.endswith("right; the road is steep")
    absurd = large._replace(test=channel_test(Interval(101.0, 90.0, 110.0)))
    assert told(absurd, explained=explained).said.endswith("right; the file is misread")
    none = told(Diagnosis(Cause.NONE), explained=explained)
    assert none.cause == "undecided" and none.said.endswith("yet the road is steep")


def test_the_largest_offset_elsewhere_is_told_beside_the_cause():
    other = Channel(0, 0, 0, "speed", "m/s"), channel_test(RIGHT, 0.75, -3.0)
    found = told(Diagnosis(Cause.COLOURED, YAW, channel_test(RIGHT), 0, other))
    assert found.said.startswith("biased: ")
    assert "besides, node 0's speed reads -3 m/s (95 %: -3.1 to -2.9) off" in found.said
    small = other[0], channel_test(RIGHT, 0.5, -3.0)
    assert (
        told(Diagnosis(Cause.COLOURED, YAW, channel_test(RIGHT), 0, small)).said[:8] == "coloured"
    )


def test_the_gravest_finding_comes_first_and_else_the_order_stays():
    levels: list[VerdictLevel] = ["WORKS", "CHECK", "FAILED", "CHECK", "FAILED"]
    findings = [
        Finding(level=level, cause=str(place), said=f"said {place}", cure="cure" * (place % 2))
        for place, level in enumerate(levels)
    ]
    found = verdict_of(findings)
    assert [one.cause for one in found.findings] == ["2", "4", "1", "3", "0"]
    assert (found.level, found.cause, found.said) == ("FAILED", "2", "said 2") and found.has_failed
    assert found.in_words() == "FAILED: said 2"
    assert verdict_of(findings[:2]).in_words() == "CHECK: said 1; cure"
    assert not verdict_of(findings[:2]).has_failed


@pytest.mark.parametrize("factor", [1.05, 1.09, 1.11, 1.2, 3.0])
def test_confidence_beyond_the_margin_is_symmetric_on_a_log_scale(factor: float):
    above = beyond(Interval(factor, sqrt(factor), factor**2))
    below = beyond(Interval(1 / factor, factor**-2, factor**-0.5))
    expected = ("overconfident", "underconfident") if factor > 1.1 else ("", "")
    assert (above, below) == expected
    assert beyond(Interval(factor, 0.99, 9)) == beyond(Interval(1 / factor, 0.1, 1.01)) == ""
    assert times_claimed(factor**-2).startswith(f"errors {factor:.3g} x")


@pytest.mark.parametrize("entries", [1, 2, 3])
@pytest.mark.parametrize("gate", [0.5, 3.84, 9.0])
def test_the_mean_of_nis_behind_a_gate_is_that_of_the_cut_law(entries: int, gate: float):
    scale = 2 ** (entries / 2) * gamma(entries / 2)
    part, _ = integrate.quad(lambda q: q ** (entries / 2) * exp(-q / 2) / scale, 0, gate)
    found = mean_behind_gate(np.array([[entries], [0]]), np.array([gate, np.inf]))
    assert found[0, 0] == pytest.approx(part / stats.chi2(entries).cdf(gate) / entries)
    assert found[0, 1] == 1 and (found[1] == 1).all()
    if entries == 1:
        inside = 2 * stats.norm.cdf(sqrt(gate)) - 1
        edge = 2 * sqrt(gate) * exp(-gate / 2) / sqrt(2 * pi)
        assert found[0, 0] == pytest.approx(1 - edge / inside)


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


def test_the_part_outside_of_the_model_is_told_with_its_reasons():
    shares = {"any": 0.25, "slow": 0.125, "sliding": 0.155, "still": 0.0}
    said = outside_in_words(shares)
    assert said == "; not judged: 25 % of the drive, outside the model (slow: 12 %, sliding: 16 %)"
    assert outside_in_words(None) == outside_in_words({"any": 0.0, "slow": 0.0}) == ""


def test_what_a_gate_refuses_does_not_count_and_the_rest_follows_the_cut_law(
    monkeypatch: pytest.MonkeyPatch,
):
    gates = stats.chi2(1).ppf([0.9, 0.9, 0.9])
    monkeypatch.setattr(gates_module, "gates_of", lambda _: gates)
    rng = np.random.default_rng(4)
    value = rng.normal(size=(1, 4000, 3, 1, 1))
    found = Innovations(value, np.ones((*value.shape, 1)), value[..., 0] ** 2)
    kept = accepted(small(nodes=3, steps=2), found)
    refused = found.nis[..., 0] > gates
    assert refused.mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_array_equal(np.isnan(kept.nis[..., 0]), refused)
    np.testing.assert_array_equal(np.isnan(kept.value[..., 0, 0]), refused)
    # 10,800 squares of variance 2 at most: five standard deviations are 0.07.
    assert np.nanmean(kept.nis) == pytest.approx(1, abs=0.07)
    np.testing.assert_allclose(kept.value[..., 0] ** 2 / kept.cov[..., 0, 0], kept.nis)
