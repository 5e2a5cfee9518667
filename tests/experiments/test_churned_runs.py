"""Sound runs with drawn settings, kills, returns, cuts and faults: the audit finds nothing."""

import os
import random
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest

from concord.nodes.commands import CutLink, HealLink, Restart, Speed
from concord.results.records.netcdf_file import ARRAYS
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.runtime.network.control_client import Client
from concord.runtime.network.network_file import read_network

FAULTS = ("loss 0.3", "corrupt 0.1", "delay 0.3 1", "duplicate 0.3", "reorder 0.4", "calm")
STEPS_PER_S = 15.0
SETTINGS = ("rounds=2", "rounds=1", "rule=ci", "rule=hcmci")


def settings(chance: random.Random) -> dict[str, str]:
    """Return drawn options of a run."""
    bus = chance.choice(["flexray", "flexray", "ideal", "can-fd"])
    slots = [] if bus == "ideal" else ["hybrid", "dynamic"]
    schedule = chance.choice(["full", "round-robin", *slots])
    return {
        "scenario": chance.choice(["oscillator", "target-tracking"]),
        "nodes": str(chance.randrange(4, 8)),
        "steps": "60",
        "seed": str(chance.randrange(10_000)),
        "graph": chance.choice(["ring", "complete"]),
        "rule": chance.choice(["ci", "hcmci", "wac", "diffusion", "labelled"]),
        "bus": bus,
        "schedule": schedule,
        "loss": chance.choice(["0", "0.2"]),
        **({} if schedule == "full" else {"occupancy": chance.choice(["0.5", "0.8"])}),
    }


def script(chance: random.Random, nodes: int) -> list[str]:
    """Return drawn changes at steps of a run of 60, in the words of `--changes`."""
    found = []
    for _ in range(chance.randrange(2, 6)):
        step, node = chance.randrange(2, 40), chance.randrange(nodes)
        other = (node + 1) % nodes
        match chance.randrange(4):
            case 0:
                back = step + chance.randrange(1, 15)
                found += [(step, f"kill {node}"), (back, f"restart {node}")]
            case 1:
                found += [(step, f"cut {node} {other}"), (step + 8, f"heal {node} {other}")]
            case 2:
                found.append((step, chance.choice(FAULTS)))
            case 3:
                found.append((step, f"set {chance.choice(SETTINGS)}"))
    return [f"{step} {words}" for step, words in sorted(found)]


def churn(folder: Path, chance: random.Random, process: subprocess.Popen) -> int:
    """Kill, restart, cut and heal at drawn moments until the run is over; return how often."""
    deadline_s, count = time.monotonic() + 120, 0
    while not (folder / "network.json").exists() and process.poll() is None:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    client = None
    with suppress(OSError, ValueError, RuntimeError):
        client = Client(read_network(folder).connect, read_network(folder).run)
        client.command(Speed(STEPS_PER_S))
    while client is not None and process.poll() is None and time.monotonic() < deadline_s:
        time.sleep(chance.uniform(0.02, 0.4))
        with suppress(OSError, ValueError, KeyError):
            nodes = [name for name in read_network(folder).pids if name.isdecimal()]
            node = chance.choice(nodes)
            match chance.randrange(4):
                case 0 | 1:
                    os.kill(read_network(folder).pids[node], signal.SIGKILL)
                    time.sleep(chance.uniform(0.05, 0.6))
                    client.command(Restart(int(node)))
                case 2:
                    client.command(CutLink(int(node), int(chance.choice(nodes))))
                case 3:
                    client.command(HealLink(int(node), int(chance.choice(nodes))))
            count += 1
    if client is not None:
        client.close()
    return count


def churned(seed: int, folder: Path, in_processes: bool) -> str:
    """Run a drawn network into a folder; return how."""
    chance = random.Random(seed)
    options = settings(chance)
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    if changes := script(chance, int(options["nodes"])):
        words += ["--changes", *changes]
    words += ["--driver", "processes" if in_processes else "in-process", "--out", str(folder)]
    command = fresh_command("concord.experiments", "run", *words)
    with subprocess.Popen(
        command, env=fresh_variables(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        count = churn(folder, chance, process) if in_processes else 0
        _, errors = process.communicate(timeout=200)
    # A run that lost a node, and not by its script, ends with exit code 1.
    assert (folder / ARRAYS).exists(), f"{' '.join(words)}\n{errors}"
    return f"{' '.join(words)}; {count} commands and kills"


def audited(folder: Path, *more: str) -> subprocess.CompletedProcess:
    command = fresh_command("concord.experiments", "audit", str(folder), *more)
    return subprocess.run(
        command, env=fresh_variables(), capture_output=True, text=True, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_churned_run_in_process_has_no_false_alarm(seed: int, tmp_path: Path):
    how = churned(seed, tmp_path / "run", in_processes=False)
    found = audited(tmp_path / "run", "--again")
    assert found.returncode == 0, f"{how}\n{found.stdout}{found.stderr}"


@pytest.mark.zenoh
def test_a_churned_run_of_processes_has_no_false_alarm(tmp_path: Path):
    how = churned(100, tmp_path / "run", in_processes=True)
    found = audited(tmp_path / "run", "--again")
    assert found.returncode == 0, f"{how}\n{found.stdout}{found.stderr}"
