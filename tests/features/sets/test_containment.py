"""The figures of sets: whether they hold the truth, in the summary and in its words."""

import json
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.nodes.history import AbsentSteps, Epoch, History
from concord.results.figures.summary import Summary, summarise
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from tests.experiments.support import small


def sets_of(mean: np.ndarray, truth: np.ndarray, history: History | None = None) -> Summary:
    """The figures of a run of three nodes whose sets (S, 3, 4) have shapes of 1."""
    setup = small("liu2021-network", nodes=3, steps=len(truth), rule="ellipsoid")
    runs = runs_of_trace(setup, read_trace(setup, in_memory(setup)))
    nees = ((mean - truth[:, None]) ** 2).sum(axis=-1)
    cov_trace = np.where(np.isnan(nees), np.nan, 4.0)
    arrays = {"mean": mean, "truth": truth, "nees": nees, "cov_trace": cov_trace}
    with_arrays = runs._replace(**{name: one[None] for name, one in arrays.items()})
    return summarise(with_arrays._replace(history=history or runs.history))


def test_outside_and_undefined_sets_are_violations_and_unknown_truth_is_not():
    truth, mean = np.zeros((4, 4)), np.zeros((4, 3, 4))
    truth[1, 0], truth[2], truth[3, 0] = 2.0, np.nan, 0.5
    mean[3, 1] = np.nan  # a node that has lost its set is no proof
    found = sets_of(mean, truth)
    assert found.value("sets") == 9 and found.value("sets_outside") == 4
    assert [node["sets_outside"].value for node in found.nodes] == [1, 2, 1]
    assert found.value("set_largest") == pytest.approx(4.0)
    assert found.value("set_half_width") == pytest.approx(2.0)
    assert (found.verdict.level, found.verdict.cause) == ("CHECK", "sets miss the truth")


def test_a_node_that_is_out_keeps_no_set():
    mean = np.zeros((2, 3, 4))
    mean[1, 2] = np.nan
    out = History((Epoch(0, 0, 3),), (AbsentSteps(2, 1, None),), True)
    found = sets_of(mean, np.zeros((2, 4)), out)
    assert (found.value("sets"), found.value("sets_outside")) == (5, 0)
    assert found.outages[0].nodes == (2,) and found.outages[0].is_asked


@pytest.mark.slow
def test_a_run_says_containment_instead_of_anees(tmp_path: Path, capsys):
    arguments = ["run", "--scenario", "liu2021-network", "--nodes", "6", "--steps", "25"]
    arguments += ["--occupancy", "0.3"]
    main([*arguments, "--out", str(tmp_path / "one"), "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["anees"][0] is None
    assert figures["sets_outside"][0] == figures["sets_outside_centralised"][0] == 0
    assert figures["set_largest"][0] <= 1
    assert [node["sets_outside"][0] for node in figures["nodes"]] == [0] * 6
    # The centralised filter hears every reading and has the smaller set.
    assert figures["set_half_width_centralised"][0] < figures["set_half_width"][0]
    main([*arguments, "--out", str(tmp_path / "two")])
    shown = capsys.readouterr().out
    assert "0 of 150 do not hold the truth" in " ".join(shown.split())
    assert "ANEES" not in shown


def test_a_gaussian_run_says_nothing_of_sets(tmp_path: Path, capsys):
    main([
        "run", "--scenario", "liu2021-network", "--rule", "ci", "--nodes", "3", "--steps", "25",
        "--out", str(tmp_path / "one"), "--json",
    ])  # fmt: skip
    figures = json.loads(capsys.readouterr().out)
    assert figures["sets"][0] is None
    assert figures["anees"][0] is not None
