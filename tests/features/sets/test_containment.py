"""The figures of sets: whether they hold the truth, in the summary and in its words."""

import json
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.filters.gaussian import Gaussian
from concord.results.figures.containment import containment


def test_outside_and_undefined_sets_are_violations_and_unknown_truth_is_not():
    truth = np.array([[0.0, 0.0], [2.0, 0.0], [0.5, 0.0], [np.nan, 0.0]])
    cov = np.broadcast_to(np.eye(2), (4, 2, 2)).copy()
    cov[2] = -np.eye(2)
    held = containment(Gaussian(np.zeros((4, 2)), cov), truth)
    assert held.violations == 2
    assert held.sets == 3
    first = containment(Gaussian(np.zeros((2, 3, 2)), np.eye(2) * np.ones((2, 3, 1, 1))), truth[:2])
    assert first.violations == 3
    assert first.largest == pytest.approx(4.0)
    assert first.half_width == pytest.approx(np.sqrt(2.0))


def test_a_node_that_is_out_keeps_no_set_and_one_that_lost_its_set_does():
    truth, cov = np.zeros((2, 2)), np.broadcast_to(np.eye(2), (2, 3, 2, 2))
    mean = np.zeros((2, 3, 2))
    mean[1, 1:] = np.nan
    kept = np.array([[True, True, True], [True, True, False]])
    found = containment(Gaussian(mean, cov), truth, kept)
    assert (found.violations, found.sets) == (1, 5)


@pytest.mark.slow
def test_a_run_says_containment_instead_of_anees(tmp_path: Path, capsys):
    arguments = ["run", "--scenario", "liu2021-network", "--nodes", "6", "--steps", "25"]
    arguments += ["--occupancy", "0.3"]
    main([*arguments, "--out", str(tmp_path / "one"), "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["anees"] is None
    assert figures["containment"]["violations"] == 0
    assert figures["containment"]["largest"] <= 1
    assert [node["containment"]["violations"] for node in figures["nodes"]] == [0] * 6
    # The centralised filter hears every reading and has the smaller set.
    central = figures["containment_centralised"]
    assert central["violations"] == 0
    assert central["half_width"] < figures["containment"]["half_width"]
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
    assert figures["containment"] is None
    assert figures["anees"] is not None
