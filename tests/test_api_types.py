"""The types of the public names: pyright accepts forty right uses and refuses forty wrong ones."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RIGHT, WRONG = (
    (ROOT / "tests" / "testdata" / f"{kind}_uses.txt").read_text(encoding="utf-8").splitlines()
    for kind in ("right", "wrong")
)
HEAD = """\
from pathlib import Path

import networkx
import numpy as np

import concord as cc
from concord.filters.gaussian import Gaussian


def own_rule(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    return Gaussian(beliefs.mean[..., 0, :], beliefs.cov[..., 0, :, :])


def own_f(x: np.ndarray) -> np.ndarray:
    return x


plant = cc.OwnPlant(f=own_f, Q=np.eye(2), mean=[0, 0], cov=[1, 1])
sensor = cc.OwnSensor(h=own_f, R=[0.1, 0.2])
scenario = cc.scenario("oscillator")
"""


@pytest.mark.slow
def test_right_uses_pass_and_wrong_ones_are_refused(tmp_path: Path):
    assert len(RIGHT) == len(WRONG) == 40
    file = tmp_path / "uses.py"
    file.write_text(HEAD + "\n".join([*RIGHT, *WRONG]) + "\n")
    settings = {"typeCheckingMode": "standard", "extraPaths": [str(ROOT)]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "pyright", "--outputjson", "-p", str(tmp_path)]
    command += ["--pythonpath", sys.executable]
    done = subprocess.run(command, capture_output=True, text=True)
    found = json.loads(done.stdout)["generalDiagnostics"]
    lines = {one["range"]["start"]["line"] for one in found if one["severity"] == "error"}
    text = file.read_text().splitlines()
    first_wrong = len(text) - len(WRONG)
    assert [text[line] for line in sorted(lines) if line < first_wrong] == []
    missed = [text[line] for line in range(first_wrong, len(text)) if line not in lines]
    assert missed == []
