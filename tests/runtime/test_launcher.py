"""A network of processes: it dies as a whole, says why, and leaves what it has recorded."""

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from concord.results.records.trace import Trace
from concord.runtime.network.links import free_ports
from concord.runtime.processes.job import Happened, Job
from concord.runtime.processes.launcher import NetworkFailed, run_processes
from concord.studies.agree import first_difference
from tests.experiments.support import reference, small, trace_of
from tests.processes import CONCORD, PATIENCE_S, PROC, family, holds_within, lives

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]

LONG = 4000


def nobody(pids: dict[str, int]) -> bool:
    return not any(map(lives, pids.values()))


class Watcher:
    """Takes what happens, and strikes once when a step is reached."""

    def __init__(self, strike: Callable[[dict[str, int]], None], step: int) -> None:
        self.happened: list[Happened] = []
        self.pids: dict[str, int] = {}
        self._strike, self._step, self._struck = strike, step, False

    def __call__(self, happened: Happened) -> None:
        self.happened.append(happened)
        self.pids = happened.pids or self.pids
        if not self._struck and happened.what == "step" and happened.step >= self._step:
            self._struck = True
            self._strike(self.pids)


def test_what_happens_is_told_in_order(tmp_path: Path):
    setup = small(steps=40)
    watcher = Watcher(lambda pids: None, 0)
    run_processes(setup, "told", tmp_path / "run.mcap", None, watcher)
    kinds = [h.what for h in watcher.happened]
    assert set(kinds[:2]) == {"started", "ready"}
    # The recorder says once how many messages were repeated, as it ends.
    assert set(kinds[2:]) == {"step", "repeated"} and kinds.count("repeated") == 1
    steps = [h.step for h in watcher.happened if h.what == "step"]
    assert steps == sorted(set(steps))
    assert steps[-1] == 40
    assert set(watcher.pids) == {"recorder", "environment", "0", "1", "2", "3"}
    assert nobody(watcher.pids)
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert first_difference(reference(setup, tmp_path), trace, "processes") is None


@pytest.mark.parametrize(
    ("victim", "named"),
    [("environment", "the environment"), ("recorder", "the recorder")],
)
def test_a_killed_process_ends_the_run_and_is_named(tmp_path: Path, victim: str, named: str):
    setup = small(steps=LONG)
    watcher = Watcher(lambda pids: os.kill(pids[victim], signal.SIGKILL), 20)
    with pytest.raises(NetworkFailed, match=f"{named} ended with signal 9"):
        run_processes(setup, "killed", tmp_path / "run.mcap", None, watcher)
    assert holds_within(PATIENCE_S, lambda: nobody(watcher.pids))
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert 15 <= trace.steps < LONG


def parent_of(pid: int) -> int:
    status = (PROC / str(pid) / "status").read_text()
    parent = next(line for line in status.splitlines() if line.startswith("PPid"))
    return int(parent.split()[1])


@pytest.mark.parametrize("stopped", [None, "0", "recorder", "environment"])
def test_a_killed_launcher_process_takes_all_with_it(tmp_path: Path, stopped: str | None):
    """Also a child that is stopped, which hears of no end."""
    setup = small(steps=LONG)

    def kill_parent(pids: dict[str, int]) -> None:
        parent = parent_of(pids["0"])
        if stopped is not None:
            os.kill(pids[stopped], signal.SIGSTOP)
        os.kill(parent, signal.SIGKILL)

    watcher = Watcher(kill_parent, 20)
    with pytest.raises(NetworkFailed, match="parent"):
        run_processes(setup, "killed", tmp_path / "run.mcap", None, watcher)
    assert holds_within(PATIENCE_S, lambda: nobody(watcher.pids))
    assert trace_of(setup, tmp_path / "run.mcap").steps >= 15


@pytest.mark.parametrize("victim", ["environment", "recorder"])
def test_a_stopped_launcher_process_still_sees_the_end_of_a_child(tmp_path: Path, victim: str):
    def strike(pids: dict[str, int]) -> None:
        os.kill(parent_of(pids["0"]), signal.SIGSTOP)
        os.kill(pids[victim], signal.SIGKILL)

    watcher = Watcher(strike, 20)
    with pytest.raises(NetworkFailed, match=f"the {victim} ended with signal 9"):
        run_processes(small(steps=LONG), "stopped", tmp_path / "run.mcap", None, watcher)
    assert holds_within(PATIENCE_S, lambda: nobody(watcher.pids))


def test_a_killed_launcher_leaves_no_stopped_launcher_process(tmp_path: Path):
    command = [*CONCORD, "run", "--scenario", "oscillator", "--steps", str(LONG)]
    command += ["--driver", "processes", "--out", str(tmp_path / "run")]
    with family(command, tmp_path) as run:
        network = tmp_path / "run" / "network.json"
        assert holds_within(PATIENCE_S, network.exists)
        pids = msgspec.json.decode(network.read_bytes())["pids"]
        os.kill(parent_of(pids["0"]), signal.SIGSTOP)
        run.send(signal.SIGKILL)
        run.process.wait()
        assert run.gone_within(PATIENCE_S)


def test_the_others_go_on_when_a_scripted_restart_dies_while_it_starts(tmp_path: Path):
    setup = small(steps=120, changes=("10 kill 3", "30 restart 3"))
    watcher = Watcher(lambda pids: None, 0)
    lives: list[int] = []

    def hear(happened: Happened) -> None:
        watcher(happened)
        pid = happened.pids.get("3")
        if happened.what == "started" and pid is not None:
            lives.append(pid)
            if len(lives) == 2:
                os.kill(pid, signal.SIGKILL)

    run_processes(setup, "boot", tmp_path / "run.mcap", None, hear)
    assert len(lives) == 2
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert trace.steps == 120


def test_an_error_of_the_launcher_takes_all_with_it(tmp_path: Path):
    def strike(pids: dict[str, int]) -> None:
        raise ZeroDivisionError

    watcher = Watcher(strike, 10)
    with pytest.raises(ZeroDivisionError):
        run_processes(small(steps=LONG), "error", tmp_path / "run.mcap", None, watcher)
    assert holds_within(PATIENCE_S, lambda: nobody(watcher.pids))


def test_a_port_in_use_is_refused_before_anything_starts(tmp_path: Path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        happened: list[Happened] = []
        with pytest.raises(ValueError, match=f"--port {port}: port {port} is in use"):
            run_processes(small(), "port", tmp_path / "run.mcap", port, happened.append)
    assert happened == []
    assert not (tmp_path / "run.mcap").exists()


def test_the_users_ports_are_used(tmp_path: Path):
    first = min(free_ports(["a"])["a"], 60000)
    listening: list[int] = []

    def look(happened: Happened) -> None:
        if happened.what == "ready":
            listening.extend(p for p in range(first, first + 7) if _listens(p))

    run_processes(small(steps=200), "ports", tmp_path / "run.mcap", first, look)
    assert listening == list(range(first, first + 7))


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


TAKEN_ONCE = """
import socket
from concord.runtime.processes import launcher_process
choose, held = launcher_process.free_ports, []
def unlucky(names):
    ports = choose(names)
    if not held:
        held.append(socket.socket())
        held[0].bind(("127.0.0.1", ports[names[{which}]]))
        held[0].listen()
    return ports
launcher_process.free_ports = unlucky
launcher_process.main()
"""


@pytest.mark.parametrize(
    ("graph", "nodes", "which"),
    [("ring", 4, 0), ("ring", 4, 1), ("ring", 4, 4), ("complete", 10, 0)],
)
def test_a_port_that_somebody_takes_first_is_no_end(
    tmp_path: Path, graph: str, nodes: int, which: int
):
    """Between choosing ports and listening at them, another program was faster."""
    setup = small(graph=graph, nodes=nodes, steps=5)
    job = msgspec.json.encode(Job(setup, "taken", str(tmp_path / "run.mcap"), 0))
    command = [sys.executable, "-c", TAKEN_ONCE.format(which=which)]
    with family(command, tmp_path, interactive=True) as child:
        assert child.process.stdin is not None
        child.process.stdin.write(job.decode() + "\n")
        child.process.stdin.flush()
        assert holds_within(PATIENCE_S, lambda: child.process.poll() is not None)
        out = child.process.stdout.read()  # type: ignore[union-attr]
    said = [msgspec.json.decode(line, type=Happened).what for line in out.splitlines()]
    assert said.count("started") == 2
    assert said[-1] == "done"
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert first_difference(reference(setup, tmp_path), trace, "processes") is None


def test_two_runs_at_once_do_not_mix(tmp_path: Path):
    """Same graph, same keys but for the name of the run, different seeds."""
    setups = [small(steps=60, seed=seed) for seed in (1, 2)]
    traces: dict[int, Trace] = {}

    def go(number: int) -> None:
        file = tmp_path / f"{number}.mcap"
        run_processes(setups[number], f"run-{number}", file, None, lambda happened: None)
        traces[number] = trace_of(setups[number], file)

    threads = [threading.Thread(target=go, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    for number, setup in enumerate(setups):
        assert first_difference(reference(setup, tmp_path), traces[number], "together") is None


def test_a_launcher_process_without_a_job_leaves_quietly(tmp_path: Path):
    """The launcher was killed before it said what to do."""
    with family(
        [sys.executable, "-m", "concord.runtime.processes.launcher_process"], tmp_path
    ) as child:
        _, out, err = child.end(PATIENCE_S)
    assert out == ""
    assert "Traceback" not in err
