"""The audit of a run: sound runs pass, and each kind of planted damage breaks its promise."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st

from concord.experiments.cli.command_line import main
from concord.nodes.messages import Timing, encode
from concord.results.records.netcdf_file import ARRAYS, RECORDING
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.runtime.recording import McapRecorder
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.studies.audit.member_history import member_history_of
from concord.studies.audit.promises import PROMISES
from concord.studies.audit.report import _around, audit
from tests.experiments.support import scenario, small, write_arrays

pytestmark = pytest.mark.slow

Messages = list[tuple[str, bytes]]
CHANGES = ("3 kill 2", "6 restart 2", "8 set rounds=2")
SETUP = small(steps=12, nodes=4, graph="ring", changes=CHANGES)
MESSAGES: Messages = list(in_memory(SETUP))


def write(folder: Path, recorded: Messages, shown: Messages = MESSAGES) -> Path:
    """A folder with this recording, and the arrays of another."""
    write_arrays(folder, SETUP, read_trace(SETUP, shown))
    recorder = McapRecorder(
        folder / RECORDING, SETUP.scenario.rounds, SETUP.time_step_s, frame_format(SETUP.scenario)
    )
    recorder.record(recorded)
    recorder.close()
    return folder


def broken(folder: Path) -> set[str]:
    return {promise.says for promise, finding in audit(folder).findings if finding.broken}


def place(topic: str, **fields: int) -> int:
    """The number of the first message on a topic with these fields."""
    return next(
        number
        for number, (name, data) in enumerate(MESSAGES)
        if name == topic and fields.items() <= json.loads(data).items()
    )


def edited(number: int, change: Callable[[dict], None]) -> Messages:
    topic, data = MESSAGES[number]
    message = json.loads(data)
    change(message)
    return [*MESSAGES[:number], (topic, json.dumps(message).encode()), *MESSAGES[number + 1 :]]


def test_a_sound_run_keeps_all_promises(tmp_path: Path):
    found = audit(write(tmp_path, MESSAGES))
    assert found.broken == 0
    assert all(finding.checked > 0 for _, finding in found.findings)
    (join,) = found.joins
    assert (join.step, join.node, join.age_steps) == (6, 2, 0)
    assert join.source in (1, 3)
    assert [one.step for one in found.around] == [3, 6, 8]


@pytest.mark.parametrize(
    "changes",
    [
        {"rule": "labelled", "schedule": "dynamic", "occupancy": 0.5},
        {"bus": "ideal", "rule": "icf", "rounds": 1},
        {"bus": "can-fd", "schedule": "hybrid", "occupancy": 0.5},
        {"changes": ("2 delay 0.3 2", "3 duplicate 0.3", "4 reorder 0.5", "5 loss 0.2")},
        {"changes": ("2 replay 1 0.3 2", "3 spoof 2 1 0.3", "4 wrong-step 3 0.3 2", "9 calm")},
        {"changes": ("2 null 1 0.5", "3 crc 2 0.5", "4 missing 0 0.5", "5 slow 3 2")},
    ],
)
def test_sound_runs_with_faults_and_other_buses_keep_all_promises(tmp_path: Path, changes: dict):
    main(["run", *_words({"nodes": 4, "steps": 12, **changes}), "--out", str(tmp_path / "run")])
    assert broken(tmp_path / "run") == set()


def _words(options: dict) -> list[str]:
    words = ["--scenario", "oscillator"]
    for name, value in options.items():
        values = value if isinstance(value, tuple) else (value,)
        words += [f"--{name}", *map(str, values)]
    return words


def _without(number: int) -> Messages:
    return MESSAGES[:number] + MESSAGES[number + 1 :]


def _twice(number: int) -> Messages:
    return MESSAGES[: number + 1] + MESSAGES[number:]


def _first_frame_of(node: int) -> int:
    return next(n for n, (topic, _) in enumerate(MESSAGES) if topic == f"share/{node}")


def _later_frame(node: int) -> tuple[str, bytes]:
    """A frame that the node sent after its return."""
    return [one for one in MESSAGES if one[0] == f"share/{node}"][-1]


def _change_heard(message: dict) -> None:
    message["changes"] = []


def _other_belief(message: dict) -> None:
    message["change"]["mean"][0] += 1e-12


def _falling(message: dict) -> None:
    message["counters"]["heard"] = 0


DAMAGE: dict[str, Callable[[], Messages]] = {
    "each recorded message can be read": lambda: [*MESSAGES, ("estimate/1", b"{")],
    "each step has one truth, and run.nc has each step": lambda: _twice(place("truth", step=4)),
    "each member has an estimate in each step": lambda: _without(place("estimate/1", step=4)),
    "each estimate in real time says its age, in the limit": lambda: edited(
        place("estimate/1", step=4), lambda message: message.update(age_s=0.1)
    ),
    "a node that is out says nothing": lambda: [
        *MESSAGES,
        ("estimate/2", MESSAGES[place("estimate/2", step=2)][1].replace(b'"step":2', b'"step":4')),
    ],
    "each message is recorded once": lambda: _twice(_first_frame_of(1)),
    "run.nc holds the recorded estimates, to the bit": lambda: edited(
        place("estimate/1", step=4), lambda message: message["mean"].__setitem__(0, 1.0)
    ),
    "run.nc shows the cycles in which nodes sent": lambda: _without(_first_frame_of(1)),
    "each share that a node holds was sent": lambda: [
        one for one in MESSAGES if one != _later_frame(1)
    ],
    "counters never fall within a life": lambda: edited(place("estimate/1", step=4), _falling),
    "all members hear of the same changes": lambda: edited(
        place("measured/1", step=3), _change_heard
    ),
    "no member takes another member for out": lambda: edited(
        place("estimate/1", step=4), lambda message: message.update(absent=[0, 2])
    ),
    "members leave, and absent nodes join": lambda: _twice(place("event", step=3)),
    "a node that joins begins with a node's estimate": lambda: edited(
        place("event", step=6), _other_belief
    ),
}


def test_each_promise_has_its_damage():
    assert set(DAMAGE) == {promise.says for promise in PROMISES}


@pytest.mark.parametrize("says", DAMAGE)
def test_damage_breaks_its_promise(tmp_path: Path, says: str, capsys):
    folder = write(tmp_path, DAMAGE[says]())
    assert says in broken(folder)
    with pytest.raises(SystemExit) as ended:
        main(["audit", str(folder)])
    assert ended.value.code == 1
    assert f"BROKEN  {says}" in capsys.readouterr().out


def test_estimates_that_were_lost_with_their_process_break_no_promise(tmp_path: Path):
    recorded = _without(place("estimate/2", step=2))
    folder = write(tmp_path, recorded, recorded)
    assert broken(folder) == set()
    notes = [
        finding.note for promise, finding in audit(folder).findings if "has an" in promise.says
    ]
    assert notes == ["1 lost with their process"]


@pytest.mark.parametrize("in_real_time", [False, True])
def test_a_node_may_join_with_an_estimate_that_only_the_clock_let_go(
    tmp_path: Path, in_real_time: bool
):
    """In real time the recorder may lose an estimate that the environment has heard."""
    says = "a node that joins begins with a node's estimate"
    heard = {place(f"estimate/{node}", step=5) for node in (1, 3)}
    timing = ("timing/1", encode(Timing(1, 4, 0.0, [0.0], 0, 0)))
    clock = [timing] if in_real_time else []
    lost = [one for number, one in enumerate(MESSAGES) if number not in heard]
    found = audit(write(tmp_path, [*lost, *clock]))
    (joins,) = [finding for promise, finding in found.findings if promise.says == says]
    assert (joins.broken, joins.note) == ((0, "1 estimates not recorded") if clock else (1, ""))
    forged = edited(place("event", step=6), _other_belief)
    assert says in broken(write(tmp_path, [*forged, *clock]))


def test_a_wild_jump_after_an_event_is_marked(tmp_path: Path, capsys):
    folder = write(tmp_path, MESSAGES)
    with xarray.open_dataset(folder / ARRAYS, engine="h5netcdf") as opened:
        arrays = opened.load()
    arrays["nees"][:, :6], arrays["nees"][:, 6:] = 1.0, 50.0
    arrays.to_netcdf(folder / ARRAYS, engine="h5netcdf")
    assert [one.jumps for one in audit(folder).around] == [False, True, False]
    with pytest.raises(SystemExit) as ended:
        main(["audit", str(folder), "--json"])
    assert ended.value.code == 0
    assert json.loads(capsys.readouterr().out)["holds"] is True


def test_cycles_are_counted_through_a_change_of_rounds():
    told = [(4, {"what": "settings", "settings": {"rounds": 5}, "first_cycle": 12})]
    found = member_history_of(3, told)
    assert [found.step_of(cycle) for cycle in (0, 2, 3, 11, 12, 16, 17)] == [0, 0, 1, 3, 4, 4, 5]
    assert found.cycles_of(3) == range(9, 12)
    assert found.cycles_of(5) == range(17, 22)


def test_a_node_that_dies_in_the_step_of_its_return_took_part_in_it():
    """It may have sent, the recorder may have lost that, and others need not hear that it was back;
    in real time its end is dated before its return."""
    told = [
        (3, {"what": "gone", "node": 1}),
        (6, {"what": "joined", "node": 1}),
        (4, {"what": "gone", "node": 1}),
    ]
    found = member_history_of(2, told)
    steps = range(9)
    assert [found.is_in(1, step) for step in steps] == [True] * 3 + [False] * 6
    assert [step for step in steps if found.dies_in(1, step)] == [3, 6]
    assert [step for step in steps if found.joins_at(1, step)] == [6]
    assert not found.repeated


@pytest.mark.parametrize("is_told", [False, True])
def test_a_return_that_ends_in_its_step_may_be_told_or_not(tmp_path: Path, is_told: bool):
    """The step of the return of node 2, from which it is out again; others heard of it, or not."""
    step = 6
    joined = MESSAGES[place("event", step=step)]
    gone = {"what": "gone", "node": 2}
    recorded: Messages = []
    for topic, data in MESSAGES:
        message = {} if topic.startswith("share") else json.loads(data)
        late = message.get("step", -1) >= step
        if topic in ("estimate/2", "measured/2") and late:
            continue
        if topic.startswith("measured/") and message["step"] == step and not is_told:
            message["changes"] = []
        recorded.append(
            (topic, data if topic.startswith("share") else json.dumps(message).encode())
        )
        if (topic, data) == joined:
            end = {"step": step, "change": gone}
            recorded += [("gone", json.dumps(gone).encode()), ("event", json.dumps(end).encode())]
    assert "all members hear of the same changes" not in broken(write(tmp_path, recorded, recorded))


def test_a_node_that_returns_twice_before_a_step_is_told_of_once(tmp_path: Path):
    """In real time it may hang again, and come back again, before the step of its return begins."""
    step, gone = 6, {"what": "gone", "node": 2}
    number = place("event", step=step)
    end = {"step": step - 1, "change": gone}
    ended = [("gone", json.dumps(gone).encode()), ("event", json.dumps(end).encode())]
    recorded = [*MESSAGES[: number + 1], *ended, *MESSAGES[number:]]
    assert "all members hear of the same changes" not in broken(write(tmp_path, recorded))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / RECORDING).unlink(), "it holds no run.mcap; name the folder"),
        (lambda folder: (folder / ARRAYS).unlink(), "it holds no run.nc; `concord collect"),
        (lambda folder: (folder / RECORDING).write_bytes(b"no"), "it cannot be read"),
    ],
)
def test_a_folder_without_evidence_is_refused(tmp_path: Path, spoil, message: str, capsys):
    folder = write(tmp_path, MESSAGES)
    spoil(folder)
    with pytest.raises(SystemExit) as ended:
        main(["audit", str(folder)])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


@given(st.lists(st.tuples(st.integers(0, 24), st.integers(0, 3)), max_size=12))
def test_what_follows_an_event_ends_with_the_next_event(told: list[tuple[int, int]]):
    """Also where the recording tells events out of order, and several of one step."""
    values = np.random.default_rng(1).uniform(1, 3, (25, 4))
    nees = xarray.DataArray(values, dims=("step", "node"), attrs={"states": ["a", "b"]})
    events = [(step, {"what": "left", "node": node}) for step, node in told]
    evidence: Any = SimpleNamespace(
        scenario=scenario(nodes=4), arrays={"nees": nees}, events=events
    )
    for (step, _), around in zip(told, _around(evidence), strict=True):
        later = [other for other, _ in told if other > step]
        after = values[step : min([step + 10, *later])]
        assert around.after == pytest.approx(after.mean(axis=1).mean(), nan_ok=True)
