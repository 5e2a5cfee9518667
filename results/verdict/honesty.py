"""Findings on honesty: whether estimates, models and readings fit each other."""

import numpy as np

from concord.results.figures.intervals import Interval
from concord.results.innovations.channel_test import LEAST_UPDATES, ChannelTest
from concord.results.innovations.diagnosis import Cause, Channel, Diagnosis
from concord.results.verdict.findings import MARGIN, Finding, VerdictLevel, beyond
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Explanation
from concord.scenarios.types.filters import UnscentedFilter

ESTIMATES_CONFIDENCE = 0.999
"""Of the two intervals of the nodes' estimates, NIS and ANEES, in runs that depend on each other
step by step."""

_UNKNOWN = Interval(np.nan, np.nan, np.nan)
_HIDDEN = (
    "models and sensors fit the readings (NIS {nis}), yet also the filter that hears everything "
    "claims too much (ANEES {best} where 1 is right): no reading shows what is off, such as an "
    "offset that all sensors of a state share; calibrate them, or add a sensor of another kind"
)
_TOO_WIDE = 10.0
"""An interval of ANEES that reaches from a tenth of 1 to ten times 1 tells nothing."""
_ABSURD = 100.0
"""NIS of a channel that no noise explains."""
_MATTERS = 0.5
"""Standard deviations of a mean beside which small innovations are no caution."""
_ALL_ALIKE = {
    Cause.ALL_NOISE_TOO_SMALL: (
        "{figures}, and other sensors are alike; their noise is larger than the filter's R: raise R"
    ),
    Cause.ALL_NOISE_TOO_LARGE: (
        "{figures}, and other sensors are alike; their noise is smaller than the filter's R: "
        "lower R"
    ),
    Cause.PROCESS_NOISE_TOO_SMALL: (
        "{figures}, and successive innovations correlate by {correlation:.2g}: the process noise Q "
        "is too small, or the model lacks a part of the motion{or_coloured}; {cure}"
    ),
    Cause.PROCESS_NOISE_TOO_LARGE: (
        "{figures}, and successive innovations correlate by {correlation:.2g}: the process noise Q "
        "is too large; lower it"
    ),
    Cause.MODEL: (
        "{figures}, their mean is {mean}, and they correlate by {correlation:.2g}: the model does "
        "not move as the readings do; {cure}"
    ),
}
_OF_ONE = {
    Cause.OFFSET: "{figures}; it reads {mean} off its prediction: correct its offset",
    Cause.NOISE_TOO_SMALL: (
        "{figures}; its noise is larger than the filter's R{or_biased}: raise R{learn}"
    ),
    Cause.OUTLIERS: (
        "{figures}: {far} of its {updates} readings are outliers, and the others have a variance "
        "of {core:.2g} where 1 is right; give the sensor a gate"
    ),
    Cause.NOISE_TOO_LARGE: "{figures}; its noise is smaller than the filter's R: lower R{learn}",
    Cause.COLOURED: (
        "{figures}, and its innovations correlate by {correlation:.2g}: its errors are not white"
    ),
}


def honesty(
    scenario: Scenario,
    diagnosis: Diagnosis,
    nis: Interval,
    anees: Interval,
    explained: Explanation,
    enough: str,
    best: Interval = _UNKNOWN,
) -> Finding:
    """The finding, computed from the diagnosis and from the nodes' own figures.

    `nis` and `anees` are those of all nodes per degree of freedom, with intervals of
    `ESTIMATES_CONFIDENCE`; ANEES is NaN where the truth is not known. The cause of `explained`, if
    there is one, takes the place of the cause that channels point to. `enough` are the options of
    a run that is long enough to judge. `best` is ANEES of the filter that hears everything.
    """
    if diagnosis.cause is Cause.UNKNOWN:
        few = f"too few readings to judge: no channel has {LEAST_UPDATES} in the scored steps"
        return Finding(level="CHECK", cause="too short", said=few, cure=f"use {enough}")
    if diagnosis.cause is not Cause.NONE:
        before, said = _of_readings(scenario, diagnosis, explained)
        lead, said = _beside_errors(before, said, anees, explained)
        cause = diagnosis.cause.value if lead == before else lead
        channel = diagnosis.channel
        where = {} if channel is None else {"node": channel.node, "sensor": channel.name}
        return Finding(level=_LEVELS[lead], cause=cause, said=f"{lead}: {said}", **where)
    if beyond(best) == beyond(anees) == "overconfident":
        said = _HIDDEN.format(nis=_short(nis.value), best=_short(best.value))
        return Finding(level="CHECK", cause="hidden error", said=f"overconfident: {said}")
    lead, said = _of_estimates(scenario, nis, anees)
    if explained.cause:
        lead = "undecided" if lead == "consistent" else lead
        said += f"; yet {explained.cause}"
    if lead not in ("cautious", "too short"):  # the rule's doing, not that of the best filter
        lead, said = _beside_errors(lead, said, anees, explained)
    cure = f"use {enough}" if lead == "too short" else ""
    return Finding(level=_LEVELS[lead], cause=lead, said=f"{lead}: {said}", cure=cure)


_LEVELS: dict[str, VerdictLevel] = {
    "overconfident": "CHECK", "biased": "CHECK", "underconfident": "CHECK", "coloured": "CHECK",
    "undecided": "CHECK", "too short": "CHECK", "consistent": "WORKS", "cautious": "WORKS",
}  # fmt: skip


def _beside_errors(
    lead: str, said: str, anees: Interval, explained: Explanation
) -> tuple[str, str]:
    """The verdict on readings, unless errors of estimates show more, or another confidence."""
    told = bool(explained.errors)
    found = Interval(*explained.anees) if told else anees
    errors = explained.errors or f"ANEES is {_short(anees.value)} where 1 is right"
    claims = beyond(found)
    if lead != "overconfident" and claims == "overconfident":
        return "overconfident", f"{errors}; innovations alone would say {lead}: {said}"
    if not told:
        return lead, said
    if lead == "underconfident" and not claims:
        # Noise that covers lasting errors of the model leaves small innovations as well.
        of_errors = "undecided" if np.isnan(found.low) else "consistent"
        return of_errors, f"{errors}; innovations alone would say {lead}: {said}"
    return lead, f"{said}; {errors}"


def _of_readings(
    scenario: Scenario, diagnosis: Diagnosis, explained: Explanation
) -> tuple[str, str]:
    assert diagnosis.channel is not None and diagnosis.test is not None, "a cause has a channel"
    test = diagnosis.test
    lead, besides = _lead(diagnosis), _besides(diagnosis)
    figures = f"NIS of {label(diagnosis.channel)} is {_short(test.nis.value)} where 1 is right"
    if explained.misread and test.nis.value > _ABSURD:
        return lead, f"{figures}; {explained.misread}"
    if explained.cause:
        return lead, f"{figures}{besides if lead == 'biased' else ''}; {explained.cause}"
    said = {**_ALL_ALIKE, **_OF_ONE}[diagnosis.cause].format(
        figures=figures,
        mean=_mean(test, diagnosis.channel),
        correlation=test.correlation,
        cure=explained.cure,
        learn=_learn(scenario),
        or_coloured="" if diagnosis.others else ", or this sensor's errors are not white",
        or_biased=_or_biased(test, diagnosis.channel),
        far=test.far,
        updates=test.updates,
        core=test.core,
    )
    if diagnosis.cause in _OF_ONE and diagnosis.others:
        plural = "channels deviate" if diagnosis.others > 1 else "channel deviates"
        said += f"; {diagnosis.others} more {plural}, less so"
    return lead, said + besides


def _besides(diagnosis: Diagnosis) -> str:
    """The channel with the largest offset, where it is another than that of the cause."""
    if diagnosis.shifted is None or diagnosis.shifted[0] == diagnosis.channel:
        return ""
    channel, off = diagnosis.shifted
    return f"; besides, {label(channel)} reads {_mean(off, channel)} off its prediction"


def outside_in_words(shares: dict[str, float] | None) -> str:
    """The end of a verdict: how much of the drive is outside the model, and why."""
    if not shares or not shares["any"]:
        return ""
    why = ", ".join(
        f"{name}: {_percent(share)}" for name, share in shares.items() if share and name != "any"
    )
    return f"; not judged: {_percent(shares['any'])} of the drive, outside the model ({why})"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def label(channel: Channel) -> str:
    """Return a channel with its node: "node 2's yaw rate"."""
    return f"node {channel.node}'s {channel.name}"


def _lead(diagnosis: Diagnosis) -> str:
    test, shifted = diagnosis.test, diagnosis.shifted
    assert test is not None, "a cause has a test"
    if test.nis.low > 1:
        return "overconfident"
    if shifted is not None and abs(shifted[1].shift) > _MATTERS:
        return "biased"
    if test.nis.high < 1:
        return "underconfident"
    return "biased" if diagnosis.cause is Cause.OFFSET else "coloured"


def _of_estimates(scenario: Scenario, nis: Interval, anees: Interval) -> tuple[str, str]:
    fits = "models and sensors fit the readings"
    for name, found in (("ANEES", anees), ("NIS", nis)):
        confidence = beyond(found)
        if confidence == "overconfident":
            shown = f"{name} {_short(found.value)} where 1 is right"
            return confidence, f"{fits}, but rule {scenario.rule.name} claims too much ({shown})"
    if not np.isnan(anees.low) and anees.low < 1 / _TOO_WIDE and anees.high > _TOO_WIDE:
        bounds = f"{_short(anees.low)} to {_short(anees.high)}"
        return "too short", f"{fits}, but ANEES {_short(anees.value)} may be {bounds}"
    if anees.value < 1 / MARGIN and not np.isnan(anees.low):
        return "cautious", f"nodes claim {times_claimed(anees.value)}"
    figures = (("NIS", nis), ("ANEES", anees))
    judged = [f"{name} {_short(found.value)}" for name, found in figures if not np.isnan(found.low)]
    said = fits
    if judged:
        said += f" ({', '.join(judged)} where 1 is right)"
    unjudged = [f"{n} {_short(f.value)}" for n, f in figures if np.isnan(f.low) and f.value > 0]
    if unjudged:
        return "too short", f"{said}; too few scored steps to judge {' and '.join(unjudged)}"
    return "consistent", said


def times_claimed(anees: float) -> str:
    """ "errors 1.25 x those they make (ANEES 0.64; 1 is exact)"."""
    return f"errors {1 / np.sqrt(anees):.3g} x those they make (ANEES {anees:.3g}; 1 is exact)"


def _mean(test: ChannelTest, channel: Channel) -> str:
    value, low, high = test.mean
    return f"{value:.2g} {channel.unit} (95 %: {low:.2g} to {high:.2g})".replace("  ", " ")


def _or_biased(test: ChannelTest, channel: Channel) -> str:
    if test.mean.low <= 0 <= test.mean.high:
        return ""
    return f", or it is biased by {test.mean.value:.2g} {channel.unit}".rstrip()


def _learn(scenario: Scenario) -> str:
    plain = isinstance(scenario.filter, UnscentedFilter)
    return ", or let nodes learn it with --filter aukf" if plain else ""


def _short(value: float) -> str:
    return f"{value:.3g}"
