"""`--data` of a scenario of the user's own: its log in every command, and logs that do not fit."""

from pathlib import Path

import numpy as np
import pytest

from concord.plants.own_readings import OwnReplay
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import in_options, scenario_of
from concord.studies.few_samples import few_steps
from tests.experiments.command_support import concord, refused

MODEL = """
import concord as cc

WALK = cc.OwnPlant(f=lambda x: x, Q=[0.01], mean=[0.0], cov=[1.0], time_step_s=0.1,
                   state_names=("place",), state_units=("m",))
EYES = [cc.OwnSensor(h=lambda x: x, R=0.04, name=name, channels=(("x", "m"),)) for name in "ab"]
SCENARIO = cc.own_scenario(WALK, EYES, steps=50, truth=cc.Truth(Q=[1.0])).with_(bus="ideal")
"""
STEPS = 80


@pytest.fixture
def name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The scenario of a file beside the logs `log.csv`, `other.csv` and `mapped/`."""
    monkeypatch.chdir(tmp_path)
    Path("walk.py").write_text(MODEL)
    for file, seed in (("log.csv", 1), ("other.csv", 2)):
        generator = np.random.default_rng(seed)
        place = np.cumsum(0.1 * generator.standard_normal(STEPS))
        read = place[:, None] + 0.2 * generator.standard_normal((STEPS, 2))
        rows = [f"{0.1 * k:.1f},{place[k]},{a},{b}" for k, (a, b) in enumerate(read)]
        Path(file).write_text("\n".join(["time,place,a_x,b_x", *rows]) + "\n")
    Path("mapped").mkdir()
    Path("mapped/columns.toml").write_text(
        'file = "../log.csv"\ntime = { column = "time", unit = "s" }\n[channels]\n'
        '"a x" = { column = "a_x", unit = "m" }\n"b x" = { column = "b_x", unit = "m" }\n'
    )
    return "./walk.py:SCENARIO"


def replay(name: str, **options: object) -> OwnReplay:
    scenario = scenario_of(name, **options)
    assert prepare(scenario).scenario.steps == STEPS
    plant = definition_of(scenario).plant(scenario)
    assert isinstance(plant, OwnReplay)
    return plant


def test_a_log_stands_for_the_simulated_readings(name: str):
    alone, mapped = replay(name, data="log.csv"), replay(name, data="mapped")
    np.testing.assert_array_equal(alone.readings, mapped.readings)
    assert np.isfinite(alone.truth).all() and np.isnan(mapped.truth).all()
    assert scenario_of(name).steps == 50
    assert scenario_of(name, data="log.csv", steps=30).steps == 30


def test_a_log_that_changed_is_read_again(name: str):
    before = replay(name, data="log.csv").readings
    Path("log.csv").write_text(Path("other.csv").read_text() + "\n")
    assert (replay(name, data="log.csv").readings != before).all()


def test_a_file_may_name_the_log_and_the_command_line_another(name: str):
    Path("walk.py").write_text(MODEL + 'LOGGED = SCENARIO.with_(data="log.csv")\n')
    logged = name.replace("SCENARIO", "LOGGED")
    first, second = replay(logged), replay(logged, data="other.csv")
    assert (first.readings != second.readings).all()
    assert "--data" not in in_options(scenario_of(logged))
    words = in_options(scenario_of(logged, data="other.csv"))
    assert words[words.index("--data") + 1] == "other.csv"


def test_nobody_is_told_to_take_more_steps_than_the_log_has(name: str):
    Path("short.csv").write_text("\n".join(Path("log.csv").read_text().splitlines()[:4]) + "\n")
    short, simulated = scenario_of(name, data="short.csv"), scenario_of(name, steps=3)
    (of_log,), (of_run,) = few_steps(short), few_steps(simulated)
    assert of_log.endswith("use a log of 40 steps or more; this one has 3")
    assert of_run.endswith("use --steps 40")
    assert "--steps" not in in_options(short)
    # The default of 50 steps is named too: a command that names none takes all 80 of the log.
    for steps in (3, 50):
        words = in_options(scenario_of(name, data="log.csv", steps=steps))
        assert words[words.index("--steps") + 1] == str(steps)


@pytest.mark.zenoh
def test_the_drivers_agree(name: str, capsys: pytest.CaptureFixture[str]):
    said = concord(capsys, "agree", "--scenario", name, "--data", "log.csv", "--steps", 20)
    assert said.code == 0, said
    assert "in-process = processes, bit for bit" in said.out


def test_logs_are_an_axis_of_a_sweep(name: str, capsys: pytest.CaptureFixture[str]):
    asked = ("--data", "log.csv,other.csv,mapped", "--rule", "ci,wac", "--runs", 1)
    said = concord(capsys, "sweep", "--scenario", name, *asked, "-o", "swept.nc", "--json")
    assert said.code == 0, said
    for cell in said.json()["cells"]:
        without = cell["cell"]["data"] == "mapped"
        assert np.isnan(np.array(cell["rmse"], dtype=float)).all() == without, cell
        assert 0 < cell["from_centralised"][0] < 1, cell


def test_a_sweep_without_a_truth_shows_how_far_rules_are_from_the_best_filter(name: str, capsys):
    asked = ("--data", "mapped", "--rule", "ci,wac", "--runs", 1)
    said = concord(capsys, "sweep", "--scenario", name, *asked, "-o", "swept.nc")
    lines = [line for line in said.out.splitlines() if line.strip()]
    first = next(place for place, line in enumerate(lines) if "B/step" in line)
    heading, *rows = lines[first:]
    assert "from central" in heading and "RMSE" not in heading and "ANEES" not in heading
    assert "NIS" in heading
    assert not any(" - " in row for row in rows), said.out


@pytest.mark.parametrize("rule", ["local", "ci"])
def test_a_sweep_has_the_innovations_of_a_log_without_a_truth(name: str, capsys, rule: str):
    """NIS of `local` is that of a scalar Kalman filter, written here; fused nodes know more."""
    asked = ("--data", "mapped", "--rule", rule, "--runs", 1)
    said = concord(capsys, "sweep", "--scenario", name, *asked, "-o", "swept.nc", "--json")
    (nis, *_) = said.json()["cells"][0]["nis"]
    first, squares = definition_of(scenario_of(name)).score.first_step, []
    for reads in np.loadtxt("log.csv", delimiter=",", skiprows=1).T[2:]:
        mean, variance = 0.0, 1.0
        for step, reading in enumerate(reads):
            variance += 0.01 * (step > 0)
            spread, miss = variance + 0.04, reading - mean
            if step >= first:
                squares.append(miss**2 / spread)
            mean, variance = mean + variance / spread * miss, variance * 0.04 / spread
    expected = np.mean(squares)
    assert (nis == pytest.approx(expected, rel=1e-6)) == (rule == "local"), (nis, expected, first)
    assert 0.5 < nis < 2


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ("none.csv", "none.csv"),
        ("walk.py", "files that end in .csv"),
        ("log.csv --nodes 3", "--nodes 3: the log has readings of 2 nodes"),
        ("log.csv --steps 81", "--steps 81: the log has 80 steps"),
    ],
)
def test_a_log_that_does_not_fit_is_refused(name: str, capsys, data: str, says: str):
    assert says in refused(concord(capsys, "run", "--scenario", name, "--data", *data.split()))


def test_a_scenario_that_takes_no_log_says_so(name: str, capsys):
    Path("slots.py").write_text(
        MODEL.replace("cc.own_scenario(WALK, EYES, steps=50, truth=cc.Truth(Q=[1.0]))",
                      "cc.on_a_measurement_bus(WALK, EYES)").replace('.with_(bus="ideal")', "")
    )  # fmt: skip
    said = concord(capsys, "run", "--scenario", "./slots.py:SCENARIO", "--data", "log.csv")
    assert "takes no readings of a log" in refused(said)
