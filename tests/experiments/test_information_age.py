"""The ages that `concord design` prints: two ways to count them, and their bound."""

from typing import Any

import numpy as np
import pytest

from concord.experiments.cli.design import lines
from concord.scenarios.catalogue import definition_named
from concord.scenarios.scenario import Scenario
from concord.studies.design.candidates import placed
from concord.studies.design.information_age import information_age, worst_age
from concord.studies.design.results import design_of
from concord.studies.design.search import SearchTask, search
from concord.studies.design.space import placements_of, space_of
from concord.studies.design.target import parse_target
from concord.studies.sweep.pieces import Piece
from concord.studies.sweep.specification import specify
from tests.experiments.test_design import engine_of

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


@pytest.mark.parametrize(
    "contended", [{"schedule": "full"}, {"schedule": "dynamic", "occupancy": 0.5}]
)
def test_over_placements_the_bound_is_the_greatest_and_holds_at_each(contended):
    """A geometric graph follows the sensors, so each placement has a diameter of its own."""
    asked = {"nodes": 8, "graph": "geometric", "rule": "ci", "rounds": 1, "steps": 30, **contended}
    network = definition_named("target-tracking").defaults.with_(**asked)
    ages = [information_age(one) for one in placed(network, [0, 1, 2, 3])]
    bounds = [one.bound_steps or 0 for one in ages if one is not None]
    assert len(bounds) == 4 and len(set(bounds)) > 1
    for one in ages:
        assert one is not None and one.bound_steps is not None
        assert 1 <= one.observed_steps <= one.bound_steps
    worst = worst_age(placed(network, [0, 1, 2, 3]))
    assert worst is not None and worst.bound_steps == max(bounds)
    assert worst.observed_steps == max(one.observed_steps for one in ages if one is not None)
    if contended["schedule"] == "full":
        assert worst.observed_steps == worst.bound_steps, "exact where no nodes contend"


def test_one_placement_without_a_bound_leaves_none():
    network = oscillator(rule="ci", graph="path", occupancy=0.2, schedule="dynamic")
    worst = worst_age([network, network.with_(arbiter="wtod"), network])
    assert worst is not None and worst.bound_steps is None
    assert "every contest with --arbiter wtod" in worst.why


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


def test_a_design_says_the_age_of_its_worst_placement():
    """The graph of placement 2 is longer than that of placement 0."""

    def figures(piece: Piece) -> dict[str, np.ndarray]:
        return {"rmse": np.ones(piece.runs), "bytes_per_step": np.full(piece.runs, 10.0)}

    asked = {
        "scenario": "target-tracking", "placement": "0,2", "nodes": "8", "graph": "geometric",
        "rule": "ci", "rounds": "1", "occupancy": "1", "weights": "metropolis", "steps": "20",
        "number": "float64",
    }  # fmt: skip
    specification = specify(asked)
    settled, space = space_of(specification)
    task = SearchTask(
        parse_target("9x-centralised"), "bytes", settled, space, 31, engine_of(figures), 1,
        lambda _: None, placements=placements_of(specification),
    )  # fmt: skip
    design = design_of(task, search(task, [], []), True)
    chosen, (front,) = design.recommended, [one for one in design.tried if one.front]
    assert chosen is not None and chosen.age is not None
    assert chosen.age.bound_steps == front.age_bound_steps == chosen.age.observed_steps == 4
    assert "age of information: at most 4 steps" in "\n".join(lines(design))
