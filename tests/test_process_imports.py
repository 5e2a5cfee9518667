"""Test what a process loads: each node and each command pays for it in memory and time."""

import subprocess
import sys
import uuid
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest

from concord.runtime.processes import launcher
from tests.conftest import ROOT
from tests.dashboard.browser_page import recorded
from tests.dashboard.runs import setup_of

HEAVY = {"scipy", "networkx", "xarray", "viser", "matplotlib", "h5py", "h5netcdf", "rich", "tyro"}
LOADED = """
import sys
import msgspec
from concord.scenarios.setup import Setup
{imports}
{work}
sys.stdout.write(" ".join(sorted({{name.partition(".")[0] for name in sys.modules}})))
"""
# A node process is handed a worked-out setup, builds its node and computes.
NODE_WORK = """
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_node, build_environment
setup = msgspec.json.decode({setup!r}, type=Setup)
nodes = [build_node(setup, node) for node in range(setup.scenario.nodes)]
in_process.run(build_environment(setup), nodes, MemoryRecorder())
"""


def loaded(imports: str, work: str = "") -> set[str]:
    """Top-level modules in a fresh interpreter after these lines."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED.format(imports=imports, work=work)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.split())


@pytest.mark.parametrize("name", ["oscillator", "target-tracking", "target-crossing"])
def test_a_node_process_stays_light(name: str):
    work = NODE_WORK.format(setup=msgspec.json.encode(setup_of(name, nodes=6, steps=2)))
    heavy = (
        loaded(
            "import concord.runtime.processes.node.process\n"
            "import concord.runtime.processes.launcher_process",
            work,
        )
        & HEAVY
    )
    assert not heavy, (
        f"a node process of {name} loads {sorted(heavy)}: every process of a network pays for it "
        "in memory and start-up time; import it inside the function that needs it"
    )


def test_the_measure_of_loading_sees_what_is_loaded():
    assert "networkx" in loaded("import concord.topology.graphs")


# A page on a recording that draws every panel, without a browser.
PAGE_WORK = """
from pathlib import Path
from concord.dashboard.serve import open_recording
setup = msgspec.json.decode({setup!r}, type=Setup)
page = open_recording(setup, Path({file!r}), "127.0.0.1", 0, light=False)
for clock_s in range(1, 9):
    page.tick(float(clock_s))
assert page.page.charts.drawn[0].times.size > 1 and not page.failures.sentences()
page.close()
"""


def test_a_page_draws_its_charts_without_scipy_which_loads_slowly(tmp_path: Path):
    setup, file = recorded(tmp_path, nodes=4, steps=6)
    work = PAGE_WORK.format(setup=msgspec.json.encode(setup), file=str(file))
    assert not loaded("", work) & {"scipy", "xarray", "matplotlib"}


# Modules of ours in this process, and their lines; a file that two names load counts once.
COUNT = """
import atexit, sys
def tell(stream):
    ours = {name: module.__file__ for name, module in sys.modules.items()
            if name.partition(".")[0] == "concord" and getattr(module, "__file__", None)}
    lines = sum(open(file, "rb").read().count(10) for file in set(ours.values()))
    stream.write(f"{lines} {' '.join(sorted(ours))}\\n")
"""
# The first process of a network, which forks the others; node 0 tells at its end.
LAUNCHER_PROCESS = """
from concord.runtime.processes import launcher_process
be_node = launcher_process.be_node
def told(job, links, config, late=False):
    try:
        be_node(job, links, config, late)
    finally:
        if config.index == 0:
            with open({file!r}, "w") as file:
                tell(file)
launcher_process.be_node = told
launcher_process.main()
"""
COMMAND = """
from concord.experiments.__main__ import main
atexit.register(tell, sys.stderr)
main({arguments!r})
"""
SIMULATION = """
import concord as cc
cc.simulate(cc.scenario("oscillator", nodes=4, steps=2))
tell(sys.stderr)
"""
ROOMS_OF_A_RUN = ("concord.filters", "concord.nodes", "concord.runtime")


class Ours(NamedTuple):
    """Modules of ours that a process has loaded, and their lines."""

    lines: int
    modules: list[str]

    def __str__(self) -> str:
        by_room = Counter(".".join(name.split(".")[1:2]) for name in self.modules)
        return f"{self.lines} lines in {len(self.modules)} modules: {by_room.most_common()}"


def ours(text: str) -> Ours:
    """Read what a process told in its last line."""
    lines, *modules = text.splitlines()[-1].split()
    return Ours(int(lines), modules)


def counted(work: str) -> Ours:
    """Count what a fresh interpreter has loaded after this work."""
    command = [sys.executable, "-c", COUNT + work]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return ours(done.stderr)


@pytest.mark.zenoh
def test_a_node_process_loads_what_it_uses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    setup = setup_of("target-tracking", rule="ci", nodes=4, steps=2)
    file = tmp_path / "loaded"
    program = COUNT + LAUNCHER_PROCESS.format(file=str(file))
    monkeypatch.setattr(launcher, "fresh_command", lambda _: [sys.executable, "-c", program])
    launcher.run_processes(setup, uuid.uuid4().hex, tmp_path / "run.mcap", None, lambda _: None)
    node = ours(file.read_text())
    assert len(node.modules) <= 180 and node.lines <= 22_000, str(node)


def test_the_smallest_simulation_loads_what_it_uses():
    simulation = counted(SIMULATION)
    assert simulation.lines <= 25_000, str(simulation)


@pytest.mark.parametrize("command", ["--help", "list"])
def test_a_command_that_shows_names_loads_no_run(command: str):
    loads = counted(COMMAND.format(arguments=[command]))
    found = [name for name in loads.modules if name.startswith(ROOMS_OF_A_RUN)]
    assert not found, f"concord {command} loads {', '.join(found)}"
