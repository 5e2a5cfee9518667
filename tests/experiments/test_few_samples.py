"""Warnings of figures that rest on few scored steps or few runs."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.experiments.python_api import simulate
from concord.results.figures.summary import LEAST_RUNS, decisive_run
from concord.scenarios.scenario_options import scenario_of
from concord.studies.few_samples import (
    LEAST_STEPS,
    few_runs,
    few_steps,
)
from tests.experiments.command_support import concord

OSCILLATOR = ("--scenario", "oscillator", "--nodes", "3")
FIRST = 20  # the step from which the oscillator is scored


@pytest.mark.parametrize(
    ("steps", "says"),
    [
        (1, ["only 1 step is scored (from step 0 of 1): "]),
        (FIRST + 2, [f"only 2 steps are scored (from step {FIRST} of {FIRST + 2}): "]),
        (FIRST + LEAST_STEPS - 1, ["only 19 steps are scored "]),
        (FIRST + LEAST_STEPS, []),
    ],
)
def test_short_runs_are_named_with_the_steps_that_suffice(steps: int, says: list[str]):
    found = list(few_steps(scenario_of("oscillator", steps=steps)))
    assert len(found) == len(says)
    for sentence, start in zip(found, says, strict=True):
        assert sentence.startswith(start) and sentence.endswith("use --steps 40")


def test_few_runs_are_named():
    assert list(few_runs(LEAST_RUNS)) == []
    (sentence,) = few_runs(2)
    assert sentence.startswith("only 2 runs: ") and sentence.endswith("use --runs 5 or more")


@pytest.mark.parametrize(
    ("command", "warned"),
    [
        (("run", "--steps", "25"), ["only 5 steps"]),
        (("run", "--steps", "40"), []),
        (("run", "--driver", "batched", "--runs", "2", "--steps", "40"), ["only 2 runs"]),
        (("run", "--driver", "batched", "--runs", "5", "--steps", "40"), []),
        (("sweep", "--graph", "ring,path", "--runs", "2", "--steps", "22", "--workers", "1"),
         ["graph=ring and in 1 more: only 2 steps", "only 2 runs"]),
        (("design", "--graph", "ring", "--rule", "ci", "--weights", "metropolis", "--rounds", "1",
          "--occupancy", ".3,1", "--schedule", "hybrid", "--runs", "2", "--steps", "22",
          "--target-rmse", "9", "--workers", "1"), ["only 2 steps", "only 2 runs"]),
    ],
)  # fmt: skip
def test_a_command_warns_once_before_it_begins(
    command: tuple[str, ...], warned: list[str], tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    said = concord(capsys, *command, *OSCILLATOR)
    assert said.code == 0
    found = [line for line in said.err.splitlines() if line.startswith("warning: only")
             or ": only" in line]  # fmt: skip
    assert len(found) == len(warned)
    for line, start in zip(found, warned, strict=True):
        assert line.startswith(f"warning: {start}")


@given(st.lists(st.floats(0.5, 2.0), min_size=LEAST_RUNS - 1, max_size=40), st.data())
def test_a_run_that_outweighs_all_others_is_named_whatever_the_unit(
    others: list[float], data: st.DataObject
):
    place = data.draw(st.integers(0, len(others)))
    total, unit = float(np.square(others).sum()), data.draw(st.sampled_from([1e-6, 1.0, 1e6]))

    def said(squared: float) -> str | None:
        errors = [*others[:place], np.sqrt(squared), *others[place:]]
        return decisive_run(unit * np.array(errors), first_run=100)

    assert said(0.99 * total) is None
    assert (said(1.01 * total) or "").startswith(f"run {100 + place} has more than half of the ")
    assert decisive_run(np.full(40, unit)) is None


def test_few_runs_and_unknown_errors_have_no_decisive_run():
    assert decisive_run(np.array([1.0, 1.0, 1.0, 99.0])) is None
    assert decisive_run(np.full(9, np.nan)) is None
    assert decisive_run(np.array([np.nan, 1.0, 1.0, 1.0, 99.0])) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "start"),
    [
        (("run", "--driver", "batched"), "warning: run 5 has"),
        (("sweep", "--rounds", "3,4", "--workers", "1"), "warning: rounds=3 and in 1 more: run 5"),
    ],
)
def test_a_command_names_the_run_in_which_the_target_leaves_all_sensors(
    command: tuple[str, ...], start: str, tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    network = ("--nodes", "12", "--graph", "geometric", "--seed", "20261127", "--runs", "8")
    said = concord(capsys, *command, *network)
    lines = (said.out + said.err).splitlines()
    assert len([line for line in lines if line.startswith(start)]) == 1


def test_no_run_is_refused_by_its_name():
    with pytest.raises(ValueError, match="runs 0: must be at least 1"):
        simulate(scenario_of("oscillator"), runs=0)
