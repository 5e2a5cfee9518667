"""A stranger without keys tells one node that another is gone."""

import time
from pathlib import Path

import msgspec
import pytest

from concord.nodes.commands import Speed
from concord.nodes.tempo import Tempo
from concord.results.records.trace import read_trace
from concord.runtime.network.links import names
from concord.runtime.recording import read_recording
from concord.scenarios.tempo import tempo_of
from concord.studies.audit.report import audit
from tests.experiments.support import write_arrays
from tests.laboratory.running import Running, neighbouring_ports, oscillators, stranger
from tests.processes import holds_within

pytestmark = pytest.mark.zenoh

FORGED = b'{"what":"gone","node":2}'


@pytest.mark.parametrize("is_timed", [False, True], ids=["lockstep", "real-time"])
def test_a_forged_end_is_noticed_mended_and_shown(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], is_timed: bool
):
    setup = oscillators(3, "complete", 200 if not is_timed else 60)
    ports = neighbouring_ports(names(setup.neighbours))
    tempo: Tempo | None = tempo_of(setup, None) if is_timed else None
    running = Running(setup, "forged", tmp_path, min(ports.values()), tempo)
    events: list[dict] = []
    running.client.listen("event", lambda _, data: events.append(msgspec.json.decode(data)))
    if not is_timed:
        running.client.command(Speed(20.0))
    liar = stranger("forged", ports["1"])
    time.sleep(0.5)
    liar.send("gone", FORGED)
    expected = {"what": "present", "node": 2, "mistaken": 1}
    assert holds_within(30, lambda: any(event["change"] == expected for event in events))
    liar.close()
    assert running.client.state()["members"] == [0, 1, 2]
    if is_timed:
        assert running.ended_within(60) and running.failure is None
        running.client.close()
    else:
        running.end()
    assert "node 1 took node 2 for out, which takes part" in capfd.readouterr().err
    trace = read_trace(setup, read_recording(tmp_path / "run.mcap"))
    counted = [one.get("falsely absent", 0) for one in trace.counters]
    assert counted == [0, 1, 0]
    write_arrays(tmp_path, setup, trace)
    findings = {promise.says: finding for promise, finding in audit(tmp_path).findings}
    agreed = findings.pop("no member takes another member for out")
    assert (agreed.broken, agreed.note) == ((0, "1 short mistakes") if is_timed else (1, ""))
    assert all(finding.broken == 0 for finding in findings.values())
