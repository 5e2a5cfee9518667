"""`concord flexray design-turns`: ages of readings, and the bound beside simulated error."""

from math import sqrt
from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.bus.flexray.presets import AUDI
from concord.features.flexray_tools.commands.rehearsal import prepare_without_bus
from concord.features.flexray_tools.commands.turn_designs import (
    TurnAnswer,
    design_turns,
    reading_ages,
)
from concord.features.flexray_tools.slot_design.turns import CycleTurn
from concord.scenarios.preparation import prepare
from concord.studies.exact.aged_readings import aged_cov, steady_cov
from concord.studies.exact.network import linear_network
from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.command_support import concord
from tests.experiments.support import scenario

NETWORK = ("--nodes", 4, "--graph", "complete", "--rule", "labelled")
OSCILLATOR = ("--scenario", "oscillator", *NETWORK)


def asked(**options: object):
    known = {"nodes": 4, "graph": "complete", "rule": "labelled", "rounds": 1, "cluster": "audi"}
    return scenario("oscillator", **{**known, **options})


def test_ages_count_steps_since_the_last_turn():
    turns = [CycleTurn(0, 1), CycleTurn(1, 2), CycleTurn(2, 4)]
    ages = reading_ages(turns, rounds=1)
    assert ages.shape == (4, 3, 3)
    assert ages[:, 0, 1].tolist() == [1, 0, 1, 0]
    assert ages[:, 1, 2].tolist() == [2, 3, 0, 1]
    assert not ages[:, :, 0].any() and not np.diagonal(ages, axis1=1, axis2=2).any()
    # With four rounds each node has a turn in every step.
    assert not reading_ages(turns, rounds=4).any()


def test_turns_in_every_cycle_lose_nothing():
    answer, slots = design_turns(prepare_without_bus(asked()), AUDI, 4, 1)
    assert answer.bound == pytest.approx(1.0) == answer.bound_of_equal_turns
    assert {one.repetition for one in slots} == {1}


def test_fewer_shares_bear_more_error_and_no_turns_are_better_than_the_best():
    setup = prepare_without_bus(asked(nodes=3))
    bounds = [design_turns(setup, AUDI, shares, 4)[0] for shares in (1, 2, 3)]
    assert all(one.exact for one in bounds)
    found = [one.bound for one in bounds]
    assert found[0] > found[1] > found[2]
    assert all(one.bound <= one.bound_of_equal_turns for one in bounds)


@pytest.mark.slow
def test_the_bound_is_the_error_of_labelled_readings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Labelled readings are fused as if in order, so a linear network reaches the bound."""
    table = tmp_path / "turns.toml"
    words = (*OSCILLATOR, "--rounds", 1, "--cluster", "audi", "--shares", 1, "--longest", 4)
    said = concord(capsys, "flexray", "design-turns", *words, "--out", table, "--json")
    answer = msgspec.json.decode(said.out, type=TurnAnswer)
    setup = prepare(asked(slots=str(table), steps=80))
    histories = simulate(setup, list(range(60)), keep=frozenset({"cov"}))
    network = linear_network(setup)
    steady = steady_cov(network)
    turns = [CycleTurn(one.base_cycle, one.repetition) for one in answer.nodes]
    wanted = aged_cov(network, steady, reading_ages(turns, 1))
    # Covariances are those of the bound, step by step and node by node; readings have 16 bits.
    period = len(wanted)
    assert histories.cov is not None
    for step in range(40, 80):
        assert np.allclose(histories.cov[0, step], wanted[step % period], rtol=1e-3)
    errors = np.square(histories.mean[:, 40:, :, 0] - histories.truth[:, 40:, None, 0])
    of_run = errors.mean(axis=(1, 2)) / steady[0, 0]
    spread = of_run.std(ddof=1) / sqrt(len(of_run))
    assert abs(of_run.mean() - answer.bound**2) < 4 * spread < 0.4
