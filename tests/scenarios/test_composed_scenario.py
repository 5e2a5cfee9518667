"""Scenarios composed of typed values: flat names in, typed values out, and what is refused."""

from typing import get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.experiments import options_page
from concord.scenarios.catalogue import definition_named, definition_of, definitions
from concord.scenarios.scenario import RuleChoice, Scenario
from concord.scenarios.scenario_options import in_options, offered_options, scenario_of
from concord.scenarios.types.assignment import assigned, check_ranges, flat
from concord.scenarios.types.buses import FlexRay, Ideal
from concord.scenarios.types.declarations import every_option
from concord.scenarios.types.option import name_of
from concord.scenarios.types.rules import (
    AverageRule,
    CovarianceIntersection,
    MeasurementFlooding,
    TrimmedCovarianceIntersection,
    UserRule,
)
from concord.scenarios.types.schedules import DynamicSchedule

USUAL = definition_named("oscillator").defaults
EACH_KIND = pytest.mark.parametrize("name", definitions())
CHOICES = {
    name: option.names
    for name, option in offered_options().items()
    if option.declaration.choices and name not in ("scenario", "filter")
}


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    """Scenarios of any rule, hold, bus and schedule that can be said together."""
    scenario = definition_named(draw(st.sampled_from(sorted(definitions())))).defaults
    for name, names in CHOICES.items():
        try:
            scenario, _ = scenario.with_known(**{name: draw(st.sampled_from(names))})
        except ValueError:
            # Not every rule has every hold, nor every bus every schedule.
            continue
    numbers = {"occupancy": st.floats(0.1, 1), "decay": st.floats(0, 1), "liars": st.integers(0, 9)}
    asked = {name: draw(strategy) for name, strategy in numbers.items()}
    return scenario.with_known(**asked)[0]


@given(scenarios())
def test_flat_names_and_values_say_the_whole_scenario(scenario: Scenario):
    found, left = assigned(definition_of(scenario).defaults, flat(scenario))
    assert (found, left) == (scenario, {})


@given(scenarios())
def test_json_says_the_whole_scenario(scenario: Scenario):
    assert msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario) == scenario


@EACH_KIND
def test_the_options_of_a_default_are_none(name: str):
    assert in_options(definition_named(name).defaults) == []


@EACH_KIND
def test_every_option_of_a_scenario_is_offered_with_a_meaning(name: str):
    for option in flat(definition_named(name).defaults):
        assert offered_options()[option].help


def test_a_field_is_declared_once():
    """Sibling values share a declaration; only the noise of a car and of a plant differ."""
    told: dict[str, set] = {}
    for one in every_option(Scenario):
        told.setdefault(one.declaration.name, set()).add(one.declaration.says)
    assert [name for name, says in told.items() if len(says) > 1] == ["noise"]


def test_what_two_rules_share_stays_when_the_rule_changes():
    scenario = USUAL.with_(rule="wac", number="float32", hold="decayed", decay=0.25)
    trimmed = scenario.with_(rule="trimmed-ci")
    assert (trimmed.rule.number, trimmed.rule.hold.decay) == ("float32", 0.25)  # type: ignore[union-attr]
    assert flat(trimmed.with_(rule="labelled", window_steps=8))["window_steps"] == 8


def test_values_are_taken_as_names_are():
    by_name = USUAL.with_(rule="labelled", window_steps=8, occupancy=0.25)
    by_value = USUAL.with_(
        rule=MeasurementFlooding(window_steps=8),
        bus=FlexRay(schedule=DynamicSchedule(occupancy=0.25)),
    )
    assert by_name == by_value
    assert USUAL.with_(bus=Ideal()) == USUAL.with_(bus="ideal")
    assert isinstance(USUAL.rule, CovarianceIntersection)


FADES = AverageRule, TrimmedCovarianceIntersection
FADING = ", ".join(
    name_of(one) for one in get_args(RuleChoice) if issubclass(one, FADES) and one is not UserRule
)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (
            {"window_steps": 8},
            "--window-steps 8: belongs to --rule labelled or labelled-ellipsoid; leave it out",
        ),
        ({"rule": "hcmci", "decay": 0.3}, f"--hold decayed of --rule {FADING} or FILE"),
        ({"hold": "drop", "decay": 0.3}, "--decay 0.3: belongs to --hold decayed; leave"),
        ({"arbiter": "wtod"}, "belongs to --schedule hybrid, hybrid-leaves or dynamic"),
        ({"bus": "ideal", "cluster": "audi"}, "--cluster audi: belongs to --bus flexray"),
        ({"schedule": "full", "occupancy": 0.5}, "--occupancy 0.5: belongs to --schedule round"),
        (
            {"rule": "trimmed-ci", "determinant_weights": False},
            f"belongs to --rule {FADING.replace('trimmed-ci, ', '')} or FILE",
        ),
        ({"rule": "labelled", "latch_delay_us": 3.0}, "belongs to --relay;"),
        ({"nodez": 3}, "unknown option 'nodez': did you mean 'nodes'"),
        ({"nodes": "many"}, "--nodes many: must be a whole number"),
        ({"bus": "ideal", "schedule": "hybrid"}, "unknown schedule 'hybrid'"),
    ],
)
def test_what_no_chosen_value_has_is_refused_with_its_owner(asked: dict, says: str):
    with pytest.raises(ValueError, match=says):
        scenario_of("oscillator", **asked)


@given(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from(["occupancy", "loss"]))
def test_ranges_are_those_of_the_declarations(value: float, name: str):
    scenario, _ = USUAL.with_(schedule="dynamic").with_known(**{name: value})
    fits = 0 < value <= 1 if name == "occupancy" else 0 <= value < 1
    if fits:
        check_ranges(scenario)
        return
    with pytest.raises(ValueError, match=f"--{name} .*must be"):
        check_ranges(scenario)


def test_the_page_of_options_is_as_the_types_declare_them():
    assert options_page.PAGE.read_text(encoding="utf-8") == options_page.page()
