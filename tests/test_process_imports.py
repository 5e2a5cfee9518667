"""Test the imports of a network's processes: each node process pays for them in memory and time."""

import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from tests.dashboard.browser_page import recorded

ROOT = Path(__file__).resolve().parent.parent
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
    from msgspec import json

    from concord.scenarios.catalogue import definition_named
    from concord.scenarios.preparation import prepare

    defaults = definition_named(name).defaults.with_(nodes=6, steps=2)
    work = NODE_WORK.format(setup=json.encode(prepare(defaults)))
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
