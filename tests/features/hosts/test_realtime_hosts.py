"""Test real time on hosts with different clocks: they keep common time or report misses."""

import json
from pathlib import Path

import numpy as np
import pytest

from concord.nodes.messages import Estimate, Timing, decode
from concord.results.folder import read_description
from concord.runtime.drivers import in_this_process
from concord.runtime.recording import read_recording
from concord.scenarios.tempo import tempo_of
from concord.studies.agree import first_difference
from tests.experiments.support import trace_of
from tests.features.hosts.hosts import hosts
from tests.features.hosts.test_hosts import two_routers, write_setup
from tests.processes import PROC

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]
STEPS = 40
CLOCK = """
import time
_monotonic, _began_s = time.monotonic, time.monotonic()
time.monotonic = lambda: _began_s + {ahead_s} + (_monotonic() - _began_s) * {rate}
"""


def with_clock(folder: Path, ahead_s: float, rate: float) -> tuple[str, ...]:
    """Return a command prefix that gives the processes another monotonic clock."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(CLOCK.format(ahead_s=ahead_s, rate=rate))
    return ("env", f"PYTHONPATH={folder}")


def run(folder: Path, *clocks: tuple[float, float]) -> tuple[dict, list[Timing | Estimate]]:
    """Nodes 0, 1 and 2, 3 on two hosts with clocks (ahead of the environment's, rate).

    Return the figures of timing, and how every step kept its time.
    """
    setup = write_setup(folder, "--driver", "realtime", steps=STEPS)
    with hosts(folder) as there:
        a, b = two_routers(there)
        for number, (clock, endpoint) in enumerate(zip(clocks, (a, b), strict=True)):
            prefix = with_clock(folder / f"clock{number}", *clock)
            nodes = (2 * number, 2 * number + 1)
            there.concord("node", setup, *nodes, "--connect", endpoint, prefix=prefix)
        environment = there.concord(
            "environment", setup, "--connect", a, "--out", folder / "run", "--json"
        )
        code, out, err = environment.end(60)
    assert code == 0, err
    messages = read_recording(folder / "run" / "run.mcap")
    said = [decode(t, data) for t, data in messages if t.startswith(("timing/", "estimate/"))]
    return json.loads(out)["timing"], said


def test_hosts_whose_clocks_are_hours_apart_stay_in_step(tmp_path: Path):
    figures, said = run(tmp_path, (7200.25, 1.0), (-86_400.5, 1.0))
    setup = read_description(tmp_path / "run").setup
    for node in range(4):
        mine = [one for one in said if isinstance(one, Timing) and one.node == node]
        assert [one.step for one in mine] == list(range(STEPS))
        late_s = np.median([late for one in mine for late in one.cycle_late_s])
        assert abs(late_s) < figures["cycle_ms"] / 1e3
        sent_s = [
            one.age_s or 0.0 for one in said if isinstance(one, Estimate) and one.node == node
        ]
        # No estimate before its three cycles are over. A busy machine may send it later, but no
        # node sends one that counts as lost.
        assert 0.04 < np.median(sent_s) < tempo_of(setup, None).oldest_s
    assert figures["deadline_misses"] < figures["cycles"] / 2
    if figures["deadline_misses"] == 0:
        in_this_process(setup, "one", tmp_path / "one.mcap", None, lambda step: None)
        one = trace_of(setup, tmp_path / "one.mcap")
        several = trace_of(setup, tmp_path / "run" / "run.mcap")
        assert first_difference(one, several, "hosts") is None


def test_a_clock_that_runs_away_is_told_by_what_it_misses(tmp_path: Path):
    """Three hundredths slow: after four seconds it is six cycles behind."""
    figures, said = run(tmp_path, (0.0, 1.0), (3600.0, 0.97))
    assert {one.node for one in said} == {0, 1, 2, 3}
    for node in (0, 1):
        mine = [one for one in said if isinstance(one, Timing) and one.node == node]
        assert [one.step for one in mine] == list(range(STEPS))
        # Both have a neighbour there, of whom nothing comes in time any more.
        assert sum(one.incomplete for one in mine if one.step >= STEPS // 2) > 3 * STEPS / 4
    assert figures["late_shares"] > STEPS
    assert figures["deadline_misses"] >= figures["incomplete"] > 3 * STEPS / 2
