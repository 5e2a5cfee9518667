"""Memory is estimated before a start, and the estimate is that of the arrays of a run."""

import re
import resource
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.python_api import simulate as simulate_in_python
from concord.results.records.runs import Runs
from concord.scenarios.catalogue import definitions
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.studies import memory
from concord.studies.memory import check_files, check_memory, check_workers, needed_bytes
from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.command_support import concord, refused

pytestmark = pytest.mark.slow

TOO_LONG = "--scenario oscillator --nodes 3 --steps 1000000000"
TARGET = ("--target-rmse", "2x-centralised")


@pytest.mark.parametrize(
    "command",
    ["run", "run --driver batched", "run --driver processes", "run --driver realtime", "agree",
     "sweep --runs 2", "sweep --graph ring,path", f"design {' '.join(TARGET)}", "setup"],
)  # fmt: skip
def test_a_run_that_does_not_fit_is_refused_before_it_begins(
    command: str, tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    out = [] if command == "agree" else ["--out", "out"]
    told = concord(capsys, *command.split(), *TOO_LONG.split(), *out)
    assert told.code == 2 and told.out == ""
    sentence = told.err.splitlines()[-1]
    for part in ("--steps 1000000000 of 3 nodes", "GB of memory are needed and ", "GB are free; "):
        assert part in sentence
    assert "use fewer --steps" in sentence and not list(tmp_path.iterdir())


def test_runs_count_together(capsys, monkeypatch):
    monkeypatch.setattr(memory, "available_memory_mb", lambda: 1000.0)
    words = ["run", "--driver", "batched", "--nodes", "20", "--steps", "60", "--runs"]
    told = refused(concord(capsys, *words, "100000"))
    assert "--steps 60 of 20 nodes in 100000 runs: about" in told
    assert "and 1000 MB are free; use fewer --steps, --runs or --nodes" in told
    with pytest.raises(ValueError, match="in 100000 runs"):
        simulate_in_python(scenario_of("target-tracking", steps=60), runs=100_000)


def test_the_result_of_a_sweep_counts_too(capsys, monkeypatch):
    monkeypatch.setattr(memory, "available_memory_mb", lambda: 10.0)
    words = ["sweep", "--scenario", "oscillator", "--nodes", "3", "--graph", "ring,path"]
    told = refused(concord(capsys, *words, "--steps", "1000", "--runs", "200"))
    assert "2 cells of 200 runs: about 24 MB of memory are needed and 10 MB are" in told


@pytest.mark.parametrize(
    ("command", "runs_each"), [("sweep --runs 400", 83), (f"design {' '.join(TARGET)}", 25)]
)
def test_the_runs_of_all_workers_count_together(
    command: str, runs_each: int, capsys, monkeypatch, tmp_path: Path
):
    """A worker holds `runs_each` runs, which fit alone, and eight workers do not."""
    one = needed_bytes(scenario_of("oscillator", nodes=4, steps=3000), runs_each) / 1024**2
    monkeypatch.setattr(memory, "available_memory_mb", lambda: 2 * one)
    monkeypatch.chdir(tmp_path)
    words = [*command.split(), "--scenario", "oscillator", "--nodes", "4", "--steps", "3000"]
    told = refused(concord(capsys, *words, "--graph", "ring,path", "--workers", "8", "-o", "out"))
    [(number, unit)] = re.findall(r"8 --workers at once: about ([\d.]+) (MB|GB)", told)
    needed = float(number) * {"MB": 1, "GB": 1024}[unit]
    # Gigabytes have one decimal.
    assert needed == pytest.approx(8 * one, rel=0.05)
    assert told.endswith("are free; use fewer --workers, --steps or --nodes\n")
    assert not list(tmp_path.glob("out*"))


def test_the_largest_pieces_of_work_count_once_for_each_worker(monkeypatch):
    monkeypatch.setattr(memory, "available_memory_mb", lambda: 10.0)
    megabytes = 1024**2
    check_workers([1 * megabytes] * 100, 10)
    check_workers([9 * megabytes, 1 * megabytes], 2)
    check_workers([9 * megabytes, 1 * megabytes, 0], 64)
    with pytest.raises(ValueError, match="3 --workers at once: about 11 MB"):
        check_workers([1 * megabytes, 9 * megabytes, 1 * megabytes], 3)


def test_a_system_that_does_not_name_its_memory_refuses_nothing(monkeypatch):
    monkeypatch.setattr(memory, "available_memory_mb", lambda: None)
    check_memory(scenario_of("oscillator", steps=10**9))


@pytest.mark.parametrize("name", [name for name in definitions() if name != "mrclam"])
def test_every_scenario_has_an_estimate_that_grows_with_its_size(name: str):
    scenario = definitions()[name].defaults
    once = needed_bytes(scenario)
    twice = scenario.with_(steps=2 * scenario.steps)
    assert once > 0 and needed_bytes(twice) == pytest.approx(2 * once, rel=1e-9)
    assert needed_bytes(scenario, 7) == 7 * once < needed_bytes(scenario, 7, messages=True)


@pytest.mark.parametrize("rule", ["ci", "hcmci"])
def test_the_estimate_holds_the_histories_and_little_more(rule: str):
    scenario = scenario_of("target-tracking", nodes=8, steps=30, rule=rule)
    histories = simulate(prepare(scenario), range(3))
    kept = sum(value.nbytes for value in _arrays(histories))
    assert kept < needed_bytes(scenario, 3) < 8 * kept


def _arrays(histories: Runs) -> list[np.ndarray]:
    return [value for value in histories if isinstance(value, np.ndarray)]


def test_a_network_that_may_open_too_few_files_is_refused(monkeypatch: pytest.MonkeyPatch):
    limits = {}
    monkeypatch.setattr(resource, "getrlimit", lambda _: (24, limits["hard"]))
    limits["hard"] = 32
    check_files("processes", 4)
    with pytest.raises(ValueError, match=r"may open 32 files, and a network of 16 nodes needs 44"):
        check_files("processes", 16)
    limits["hard"] = resource.RLIM_INFINITY
    check_files("processes", 1000)
