"""The ages that `concord design` prints: two ways to count them, and their bound."""

from typing import Any

import pytest

from concord.experiments.design.information_age import information_age
from concord.scenarios.catalogue import definition_named
from concord.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow


def oscillator(**options: Any) -> Scenario:
    return definition_named("oscillator").defaults.with_(nodes=6, steps=30, **options)


@pytest.mark.parametrize("graph", ["path", "ring"])
def test_records_and_shares_are_as_old_where_shares_have_room(graph):
    records = information_age(oscillator(rule="labelled", graph=graph))
    beliefs = information_age(oscillator(rule="ci", graph=graph))
    assert records is not None
    assert beliefs is not None
    assert records._replace(lost=None) == beliefs
    assert records.lost is None, "no window has passed"
    assert records.observed_steps == records.bound_steps


@pytest.mark.parametrize("rule", ["ci", "labelled"])
def test_contended_slots_bound_the_age_where_age_decides(rule):
    """Six nodes on a path: five links, each after 2 * 6 - 1 cycles at most, at first."""
    options = {"graph": "path", "occupancy": 0.2, "schedule": "dynamic", "rule": rule}
    age = information_age(oscillator(**options))
    assert age is not None
    assert 1 <= age.observed_steps < 30
    if rule == "ci":
        assert age.bound_steps == -(-(4 * 7 + 11) // 3) - 1
        assert age.observed_steps <= age.bound_steps
        assert age.why == "a contender wins once in 7 cycles at least"
    else:
        assert age.bound_steps == 31
        assert "its window of 32 steps is lost (schedule and graph allow 128 steps)" in age.why
        wide = information_age(oscillator(window_steps=255, **options))
        assert wide is not None
        assert wide.bound_steps == -(-5 * (72 + 5) // 3) - 1


@pytest.mark.parametrize(
    "more",
    [
        {"occupancy": 0.2, "schedule": "dynamic", "arbiter": "wtod", "rounds": 1},
        {"loss": 0.6, "repeat_above": 2},
        {"withhold_below": 0.3},
        {"occupancy": 0.2, "schedule": "round-robin", "rounds": 1},
    ],
)
def test_records_that_outlive_their_window_are_lost_and_not_old(more):
    """Neither arbiter, links, silence nor turns let a record of four steps arrive."""
    age = information_age(oscillator(rule="labelled", graph="path", window_steps=4, **more))
    assert age is not None
    assert age.observed_steps == age.bound_steps == 3
    assert age.lost is not None
    assert 0 < age.lost < 1


def test_what_lets_a_node_wait_for_ever_is_named():
    options = {"rule": "ci", "graph": "path", "occupancy": 0.2, "schedule": "dynamic"}
    for more, why in [
        ({"arbiter": "wtod"}, "every contest with --arbiter wtod"),
        ({"trigger": 0.5}, "--trigger"),
    ]:
        age = information_age(oscillator(**options, **more))
        assert age is not None
        assert age.bound_steps is None
        assert why in age.why


def test_losses_are_seen_in_records_alone():
    lossy = {"graph": "path", "loss": 0.3}
    sound = information_age(oscillator(rule="labelled", graph="path"))
    late = information_age(oscillator(rule="labelled", **lossy))
    assert sound is not None
    assert late is not None
    assert late.observed_steps > sound.observed_steps
    assert late.bound_steps == 31
    assert information_age(oscillator(rule="ci", **lossy)) is None
