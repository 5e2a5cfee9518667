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
    assert records == beliefs
    assert records.observed_steps == records.bound_steps


def test_a_tenth_of_the_bus_has_ages_and_no_bound():
    options = {"graph": "path", "occupancy": 0.2, "schedule": "dynamic"}
    for rule in ("ci", "labelled"):
        age = information_age(oscillator(rule=rule, **options))
        assert age is not None
        assert age.bound_steps is None
        assert 1 <= age.observed_steps < 30


def test_losses_are_seen_in_records_alone():
    lossy = {"graph": "path", "loss": 0.3}
    sound = information_age(oscillator(rule="labelled", graph="path"))
    late = information_age(oscillator(rule="labelled", **lossy))
    assert sound is not None
    assert late is not None
    assert late.observed_steps > sound.observed_steps
    assert information_age(oscillator(rule="ci", **lossy)) is None
