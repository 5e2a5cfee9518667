"""Ctrl-C, a polite end or a sudden death of the command, at any moment.

No process is left behind, and the recording can be read.
"""

import json
import os
import random
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray
from mcap.reader import make_reader

from concord.results.folder import read_description
from concord.results.records.netcdf_file import ARRAYS, DESCRIPTION, RECORDING
from concord.results.records.trace import read_trace
from concord.runtime.network.network_file import read_network
from concord.runtime.recording import read_recording
from concord.studies.monte_carlo.simulate import simulate
from tests.processes import CONCORD, PATIENCE_S, PROC, Family, family

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]

INTERRUPTED = 130
# The text on standard error at each moment, and the number of steps of the run.
MOMENTS = {
    # The steps are so many that the run cannot end before the test looks, even on a busy machine.
    "before ready": ("seed", 3000),
    "in the middle": ("oscillator: ", 3000),
    "near the end": ("oscillator: 60 of 60", 60),
}


def run_command(driver: str, steps: int) -> list[str]:
    options = f"--scenario oscillator --nodes 4 --steps {steps} --driver {driver} --out run"
    return [*CONCORD, "run", *shlex.split(options)]


def check_folder(folder: Path) -> int:
    """The number of complete steps in what a run has left; whatever is there can be read."""
    description = read_description(folder)
    steps = 0
    if (folder / RECORDING).exists():
        steps = read_trace(description.setup, read_recording(folder / RECORDING)).steps
    if (folder / ARRAYS).exists():
        with xarray.open_dataset(folder / ARRAYS, engine="h5netcdf") as dataset:
            assert dataset.sizes["step"] == steps
    return steps


def interrupted(run: Family, signal_number: int) -> str:
    """Standard error after the signal; checks the end."""
    if signal_number == signal.SIGINT:
        run.send_to_group(signal_number)  # as Ctrl-C does
    else:
        run.send(signal_number)
    code, _, err = run.end(run.at_once_s)
    assert code == INTERRUPTED, err
    assert "Traceback" not in err
    assert run.gone_at_once()
    return err


@pytest.mark.parametrize(
    ("how", "moment"),
    [
        (signal.SIGINT, "before ready"),
        (signal.SIGINT, "in the middle"),
        (signal.SIGTERM, "in the middle"),
        (signal.SIGTERM, "near the end"),
    ],
)
def test_an_interrupted_network_ends_at_once_and_leaves_its_folder(
    tmp_path: Path, how: signal.Signals, moment: str
):
    line, steps = MOMENTS[moment]
    with family(run_command("processes", steps), tmp_path) as run:
        run.await_line(line)
        if moment == "in the middle":
            assert (
                len(run.descendants()) == 1 + 2 + 4
            )  # launcher process, environment and recorder, nodes
        interrupted(run, how)
    if moment != "before ready":
        with (tmp_path / "run" / RECORDING).open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None, "other readers of MCAP want a footer"
    done = check_folder(tmp_path / "run")
    if moment == "in the middle":
        assert 0 < done < steps
    if moment == "near the end":
        assert done >= steps - 1  # the last estimate may still be on its way to the recorder


def test_an_interrupted_run_in_one_process_leaves_its_folder(tmp_path: Path):
    with family(run_command("in-process", 1000), tmp_path) as run:
        run.await_line("oscillator: ")
        interrupted(run, signal.SIGINT)
    steps = check_folder(tmp_path / "run")
    assert 0 < steps < 1000
    # Arrays and figures of what was done are made when there is time.
    asked = subprocess.run(
        [*CONCORD, "collect", "--json", str(tmp_path / "run")], capture_output=True, check=True
    )
    assert json.loads(asked.stdout)["steps"] == steps
    assert (tmp_path / "run" / ARRAYS).exists()
    assert check_folder(tmp_path / "run") == steps


@pytest.mark.parametrize(
    ("scenario", "asked"),
    [
        ("oscillator --graph ring --nodes 8200 --bus ideal", 12),
        # So many that a fast machine is not done with them when progress is told next.
        ("vehicle-network --filter ukf --changes '1 corrupt 0.01'", 800),
    ],
    ids=["one run at a time is as much as fits", "message by message"],
)
def test_interrupted_runs_of_many_keep_those_that_are_complete(
    tmp_path: Path, scenario: str, asked: int
):
    options = f"--scenario {scenario} --steps 2 --driver batched --runs {asked} --out run --json"
    with family([*CONCORD, "run", *shlex.split(options)], tmp_path) as run:
        while json.loads(run.await_line('"event":"progress"'))["done"] < 8:
            pass
        run.send_to_group(signal.SIGINT)
        code, said, err = run.end(3 * PATIENCE_S)
    assert code == INTERRUPTED and "Traceback" not in err, err
    runs = json.loads(said)["runs"]
    assert f"interrupted: {runs} of {asked} runs are complete, 0 to {runs - 1}; " in err
    with xarray.open_dataset(tmp_path / "run" / ARRAYS, engine="h5netcdf") as dataset:
        kept = dataset["mean"].values
        assert dataset["run"].values.tolist() == list(range(runs))
    assert 3 <= runs < asked  # the fourth may not be whole when its last step is said to be done
    # The kept results are those of a command for so many runs.
    setup = read_description(tmp_path / "run").setup
    np.testing.assert_array_equal(kept[-1:], simulate(setup, [runs - 1]).mean)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_while_the_program_loads_is_as_quiet(tmp_path: Path, how: signal.Signals):
    """Loading takes longer than many a run, and is when people think better of it."""
    command = run_command("processes", 700)
    command.insert(1, "-Ximporttime")  # says on standard error what has been loaded
    with family(command, tmp_path) as run:
        run.await_line(" numpy\n")
        run.send(how)
        code, _, err = run.end(run.at_once_s)
        # A shell reports the death by Ctrl-C as 130 too.
        assert code in (INTERRUPTED, -how)
        assert "Traceback" not in err
        assert run.gone_at_once()
    assert list(tmp_path.iterdir()) == []


# Python imports this module at the start of a process; the command itself is not a module.
SLOW_TO_LOAD = """
import select, sys, time
if "-m" in sys.orig_argv:
    select.select([sys.stdin], [], [])
    sys.stderr.write("has a job, and loads\\n")
    sys.stderr.flush()
    time.sleep(600)
"""
PATIENT = """
import sys
from concord.experiments import __main__
from concord.runtime.processes import launcher
launcher._STOP_TIMEOUT_S = 600
__main__.main(sys.argv[1:])
"""


def test_an_interruption_waits_for_no_process_that_still_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """On a busy machine the parent of the network's processes takes many seconds to load."""
    (tmp_path / "sitecustomize.py").write_text(SLOW_TO_LOAD)
    paths = [str(tmp_path), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    command = [sys.executable, "-c", PATIENT, *run_command("processes", 700)[len(CONCORD) :]]
    with family(command, tmp_path) as run:
        run.await_line("has a job, and loads")
        interrupted(run, signal.SIGINT)
    check_folder(tmp_path / "run")


def test_a_second_ctrl_c_does_no_harm(tmp_path: Path):
    with family(run_command("processes", 700), tmp_path) as run:
        run.await_line("oscillator: ")
        run.send(signal.SIGINT)
        time.sleep(0.05)
        run.send(signal.SIGINT)
        code, _, _ = run.end(run.at_once_s)
        assert code == INTERRUPTED
        assert run.gone_within(run.at_once_s)
    check_folder(tmp_path / "run")


@pytest.mark.parametrize("moment", ["before ready", "in the middle"])
def test_a_killed_command_takes_its_network_with_it(tmp_path: Path, moment: str):
    line, steps = MOMENTS[moment]
    with family(run_command("processes", steps), tmp_path) as run:
        run.await_line(line)
        run.send(signal.SIGKILL)
        run.process.wait(run.at_once_s)
        # A process that still loads sees the end of its parent when it is loaded.
        assert run.gone_within(run.at_once_s if moment == "in the middle" else PATIENCE_S)
    assert check_folder(tmp_path / "run") < steps


def test_a_run_that_fails_says_where_its_remains_are(tmp_path: Path):
    """After the environment is killed: exit code 1, its name, and no figures."""
    with family(run_command("processes", 700), tmp_path) as run:
        run.await_line("oscillator: ")
        os.kill(read_network(tmp_path / "run").pids["environment"], signal.SIGKILL)
        code, out, err = run.end(run.at_once_s)
        assert code == 1
        assert "ended with signal 9" in err
        assert "concord collect run" in err
        assert out == ""
        assert run.gone_at_once()
    assert check_folder(tmp_path / "run") > 0


@pytest.mark.parametrize("how", ["removed", "moved"])
def test_a_run_whose_folder_goes_ends_and_says_so(tmp_path: Path, how: str):
    with family(run_command("processes", 3000), tmp_path) as run:
        run.await_line("oscillator: ")
        if how == "removed":
            shutil.rmtree(tmp_path / "run")
        else:
            (tmp_path / "run").rename(tmp_path / "elsewhere")
        # The launcher looks once a second.
        code, out, err = run.end(run.at_once_s + 2)
        assert (code, out) == (1, "")
        assert "run.mcap was removed or moved while the run went on" in err
        assert "Traceback" not in err
        assert run.gone_at_once()


def test_a_run_that_loses_a_node_says_so_and_goes_on(tmp_path: Path):
    with family(run_command("processes", 300), tmp_path) as run:
        run.await_line("oscillator: ")
        os.kill(read_network(tmp_path / "run").pids["2"], signal.SIGKILL)
        run.await_line("node 2 ended with signal 9; the others go on")
        code, said, _ = run.end(30)
    # The others went on, but nobody asked to lose it.
    assert code == 1 and said.startswith("FAILED node 2: lost from step")
    assert check_folder(tmp_path / "run") == 300


@pytest.mark.study
def test_twenty_launches_with_an_interruption_at_a_random_moment(tmp_path: Path):
    """No first line is awaited, so how busy the machine is stays unknown: only a hang fails."""
    generator = random.Random(20)
    for attempt in range(20):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        how = generator.choice([signal.SIGINT, signal.SIGTERM])
        with family(run_command("processes", 150), folder) as run:
            time.sleep(generator.uniform(0.0, 2.5))
            if run.process.poll() is None:
                run.send(how)
            code, _, err = run.end(PATIENCE_S)
            # Before our first line and after our last, Python answers a signal in its own way.
            # While it starts, its way is an exit code of 1 and its own traceback.
            python_starts = code == 1 and "experiments/__main__.py" not in err
            known = (0, INTERRUPTED, -signal.SIGINT, -signal.SIGTERM)
            assert code in known or python_starts, err
            assert code == INTERRUPTED or "seed" not in err or "150 of 150" in err
            assert run.gone_within(PATIENCE_S)
        if (folder / "run" / DESCRIPTION).exists():
            check_folder(folder / "run")
