"""VerdictOnRuns on a logged car: its errors of side slip beside the innovations."""

import numpy as np
import pytest

from concord.features.vehicle.scenario import DEFINITION
from concord.features.vehicle.slip_evidence import SlipEvidence
from concord.filters.gaussian import Gaussian
from concord.results.figures.intervals import Interval
from concord.results.innovations.diagnosis import Cause, Diagnosis
from concord.scenarios.scenario_definition import Explanation
from concord.scenarios.setup import Setup
from tests.experiments.innovation_verdicts import (
    FITTING,
    OFF,
    OVER,
    TOO_SMALL,
    UNDER,
    UNKNOWN,
    YAW,
    verdict,
)
from tests.experiments.support import scenario


def told(slip: SlipEvidence) -> Explanation:
    return Explanation(errors=slip.in_words(), anees=slip.anees)


def cure_of(cause: Cause, **options) -> str:
    """The verdict on two runs of a car; no log is read for the cure."""
    car = scenario("vehicle-network", **options)
    setup = Setup(car, [[]] * 4, [[1.0]] * 4, [], [], [], 0.005)
    beliefs = Gaussian(np.zeros((2, 3, 6)), np.zeros((2, 3, 6, 6)))
    explained = DEFINITION.explain(setup, beliefs, np.ones((2, 3), bool))
    return verdict(car, Diagnosis(cause, YAW, OFF), FITTING, FITTING, explained).said


def test_identification_is_named_only_where_there_is_a_log():
    assert "identify" not in cure_of(Cause.MODEL)
    logged = cure_of(Cause.MODEL, data="drives/one")
    assert "`concord identify-car --data drives/one` fits the car's model to the log" in logged
    assert "identify" not in cure_of(Cause.OFFSET, data="drives/one")


def test_errors_of_the_slip_lead_where_innovations_are_small():
    """A verdict said "underconfident" of a car whose side slip had an ANEES of 2.9."""
    of_readings = Diagnosis(Cause.NOISE_TOO_LARGE, YAW, TOO_SMALL)
    given = scenario("vehicle-network"), of_readings, FITTING, UNKNOWN
    sentence = verdict(*given, told(SlipEvidence(OVER, False, (14.0, 3.2, 4.6)))).said
    assert sentence.startswith(
        "overconfident: the side slip errs by more than the filter that hears everything claims "
        "(ANEES 2.3 to 3.7 where 1 is right, by what yaw rate and lateral acceleration add up to, "
        "which errs too; most from 3.2 to 4.6 s of the run: 14)"
    )
    assert "innovations alone would say underconfident: NIS of node 2's yaw rate" in sentence


@pytest.mark.parametrize(
    ("anees", "words"),
    [
        (FITTING, "errs as the filter that hears everything claims (ANEES 1 where 1 is right, by"),
        (Interval(0.3, 0.2, 0.4), "errs by less than the filter that hears everything claims"),
    ],
)
def test_a_side_slip_that_is_no_worse_than_claimed_stands_at_the_end(anees, words: str):
    nothing, slip = Diagnosis(Cause.NONE), SlipEvidence(anees, True)
    given = scenario("vehicle-network"), nothing, FITTING, FITTING
    sentence = verdict(*given, told(slip)).said
    assert sentence.startswith("consistent: ")
    assert words in sentence and sentence.endswith("by the logged one)")


def test_process_noise_that_covers_the_tyres_is_no_wrong_claim():
    """After `identify` innovations are smaller than claimed, where the side slip is as claimed."""
    of_readings = Diagnosis(Cause.NOISE_TOO_LARGE, YAW, TOO_SMALL)
    given = scenario("vehicle-network"), of_readings, FITTING, FITTING
    sentence = verdict(*given, told(SlipEvidence(FITTING, True))).said
    assert sentence.startswith("consistent: the side slip errs as the filter")
    assert "innovations alone would say underconfident: " in sentence
    untold = verdict(*given, told(SlipEvidence(UNKNOWN, False))).said
    assert untold.startswith("undecided: this drive does not tell how far the side slip errs; ")
    less = verdict(*given, told(SlipEvidence(Interval(0.3, 0.2, 0.4), True))).said
    assert less.startswith("underconfident: ")
    # Caution is the rule's doing, and no fault.
    by_rule = scenario("vehicle-network"), Diagnosis(Cause.NONE), FITTING, UNDER
    found = verdict(*by_rule, told(SlipEvidence(FITTING, True)))
    assert (found.level, found.cause) == ("WORKS", "cautious")
