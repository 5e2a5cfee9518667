"""The audit of a run: sound runs pass, and each kind of planted damage breaks its promise."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st

from concord.experiments.cli.command_line import main
from concord.nodes.changes import Event, Gone
from concord.nodes.history import history_of
from concord.nodes.messages import Timing, encode
from concord.results.folder import describe, write_description
from concord.results.records.netcdf_file import ARRAYS, RECORDING, write_dataset
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.runtime.recording import McapRecorder, origin_of
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.audit.again import computed_again
from concord.studies.audit.member_history import member_history_of
from concord.studies.audit.promises import PROMISES, Run
from concord.studies.audit.report import _around, _complete, audit
from tests.experiments.support import scenario, small, write_arrays

pytestmark = pytest.mark.slow

Messages = list[tuple[str, bytes]]
CHANGES = ("3 kill 2", "6 restart 2", "8 set rounds=2", "9 loss 0.2")
SETUP = small(steps=12, nodes=4, graph="ring", schedule="hybrid", occupancy=0.5, changes=CHANGES)
MESSAGES: Messages = list(in_memory(SETUP))


@cache
def sound_arrays() -> bytes:
    """The arrays of MESSAGES, written once."""
    with TemporaryDirectory() as folder:
        write_description(Path(folder), describe("test", "in-process", SETUP))
        write_arrays(Path(folder), SETUP, read_trace(SETUP, MESSAGES))
        return (Path(folder) / ARRAYS).read_bytes()


def write(folder: Path, recorded: Messages, shown: Messages = MESSAGES, of: Setup = SETUP) -> Path:
    """A folder with this recording, and the arrays of another; `of` made both."""
    write_description(folder, describe("test", "in-process", SETUP))
    if shown is MESSAGES:
        (folder / ARRAYS).write_bytes(sound_arrays())
    else:
        write_arrays(folder, SETUP, read_trace(SETUP, shown))
    frames, origin = frame_format(SETUP.scenario), origin_of(of, "test")
    recorder = McapRecorder(
        folder / RECORDING, SETUP.scenario.rounds, SETUP.time_step_s, frames, origin
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
    assert [one.step for one in found.around] == [3, 6, 8, 9]


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


def _change_heard(message: dict) -> None:
    message["changes"] = []


def _other_belief(message: dict) -> None:
    message["change"]["mean"][0] += 1e-12


def _with_counter(name: str, value: int) -> Callable[[dict], None]:
    return lambda message: message["counters"].update({name: value})


def _one_ulp(field: str) -> Callable[[dict], None]:
    def change(message: dict) -> None:
        message[field][0] = float(np.nextafter(message[field][0], 9.0))

    return change


def _swapped(first: int, second: int) -> Messages:
    found = list(MESSAGES)
    found[first], found[second] = found[second], found[first]
    return found


def _moved(topic: str, number: int) -> Messages:
    return [*MESSAGES[:number], (topic, MESSAGES[number][1]), *MESSAGES[number + 1 :]]


def _frame(node: int, which: int = 0) -> int:
    return [n for n, (topic, _) in enumerate(MESSAGES) if topic == f"share/{node}"][which]


def _flipped(number: int) -> Messages:
    topic, data = MESSAGES[number]
    wrong = bytes([*data[:-1], data[-1] ^ 1])
    return [*MESSAGES[:number], (topic, wrong), *MESSAGES[number + 1 :]]


def _added(topic: str, data: bytes) -> Messages:
    return [*MESSAGES, (topic, data)]


def _cut(step: int) -> Messages:
    """Without what belongs to later steps than this one."""
    frames = frame_format(SETUP.scenario)
    history = history_of(SETUP.scenario.rounds, ())
    found: Messages = []
    for topic, data in MESSAGES:
        if topic.startswith("share/"):
            of = history.place(frames.read(data).cycle)[0]
        else:
            said = json.loads(data)
            of = said["step"] if "step" in said else history.place(said["cycle"])[0]
        if of <= step:
            found.append((topic, data))
    return found


OTHER = prepare(SETUP.scenario.with_(seed=2))
OTHER_MESSAGES: Messages = list(in_memory(OTHER))
IN_ORDER, ONE_RUN = "messages stand in order, at their times", "run.json, run.mcap and run.nc are"
READ, ONCE = "each recorded message can be read", "each message is recorded once"
ESTIMATES, TRUTHS = "run.nc holds the recorded estimates", "run.nc holds the recorded truths"
READINGS, CONTESTS = "each member gets its readings", "each contest has its bids and one grant"
TOTALS, CHANGES_HEARD = "counters tell the recorded frames", "all members hear of the same changes"
AGAIN = "again"
"""Only the computation again finds it."""

RECORDED: dict[str, tuple[str, Callable[[], Messages]]] = {
    "a message that is no JSON": (READ, lambda: _added("estimate/1", b"{")),
    "an unknown topic": (READ, lambda: _moved("estimates/1", place("estimate/1", step=4))),
    "a node that the network lacks": (
        READ,
        lambda: _moved("estimate/9", place("estimate/1", step=4)),
    ),
    "an estimate on the topic of another node": (
        READ,
        lambda: _moved("estimate/3", place("estimate/1", step=4)),
    ),
    "a flipped bit of a frame": (READ, lambda: _flipped(_frame(1))),
    "a frame on the topic of another node": (
        ONCE,
        lambda: [*MESSAGES[: _frame(1)], MESSAGES[_frame(0)], *MESSAGES[_frame(1) :]],
    ),
    "a frame of another node in its place": (
        "run.nc shows the cycles",
        lambda: _moved("share/3", _frame(1)),
    ),
    "a truth left out": ("each step has one truth", lambda: _without(place("truth", step=4))),
    "a truth twice": ("each step has one truth", lambda: _twice(place("truth", step=4))),
    "another truth": (
        TRUTHS,
        lambda: edited(
            place("truth", step=4), lambda m: m["state"].__setitem__(0, m["state"][0] + 0.5)
        ),
    ),
    "a heartbeat left out": (READINGS, lambda: _without(place("measured/1", step=4))),
    "a heartbeat twice": (ONCE, lambda: _twice(place("measured/1", step=4))),
    "another reading": (
        READINGS,
        lambda: edited(place("measured/0", step=4), lambda m: m["readings"][0].__setitem__(0, 7.5)),
    ),
    "a change that one node did not hear": (
        CHANGES_HEARD,
        lambda: edited(place("measured/1", step=3), _change_heard),
    ),
    "an estimate left out": (
        "each member has an estimate",
        lambda: _without(place("estimate/1", step=4)),
    ),
    "an estimate twice": (ONCE, lambda: _twice(place("estimate/1", step=4))),
    "two estimates swapped": (
        IN_ORDER,
        lambda: _swapped(place("estimate/1", step=4), place("estimate/1", step=5)),
    ),
    "a mean, the last bit": (
        ESTIMATES,
        lambda: edited(place("estimate/1", step=4), _one_ulp("mean")),
    ),
    "a covariance, the last bit": (
        ESTIMATES,
        lambda: edited(place("estimate/1", step=4), _one_ulp("cov")),
    ),
    "an age in lockstep": (
        "each estimate in real time says its age",
        lambda: edited(place("estimate/1", step=4), lambda m: m.update(age_s=0.1)),
    ),
    "a false absence": (
        "no member takes another member",
        lambda: edited(place("estimate/1", step=4), lambda m: m.update(absent=[0, 2])),
    ),
    "a counter that falls": (
        "counters never fall",
        lambda: edited(place("estimate/1", step=4), _with_counter("heard", 0)),
    ),
    "more frames sent than there are": (
        TOTALS,
        lambda: edited(place("estimate/1", step=11), _with_counter("sent", 999)),
    ),
    "more frames heard than were sent": (
        TOTALS,
        lambda: edited(place("estimate/1", step=11), _with_counter("heard", 999)),
    ),
    "one frame heard too many": (
        AGAIN,
        lambda: edited(
            place("estimate/1", step=11),
            lambda m: m["counters"].update(heard=m["counters"]["heard"] + 1),
        ),
    ),
    "other weights": (
        AGAIN,
        lambda: edited(place("estimate/1", step=4), lambda m: m["weights"].__setitem__(0, 0.5)),
    ),
    "a word of a node that is out": (
        "a node that is out says nothing",
        lambda: _added(
            "estimate/2", MESSAGES[place("estimate/2", step=2)][1].replace(b'"step":2', b'"step":4')
        ),
    ),
    "a frame left out": ("run.nc shows the cycles", lambda: _without(_frame(1))),
    "a frame twice": (ONCE, lambda: _twice(_frame(1))),
    "frames of two cycles swapped": (IN_ORDER, lambda: _swapped(_frame(1, 2), _frame(1, 3))),
    "a share that others hold left out": (
        "each share that a node holds",
        lambda: [one for one in MESSAGES if one != MESSAGES[_frame(1, -1)]],
    ),
    "a bid left out": (CONTESTS, lambda: _without(_bid(won=False))),
    "a winner's bid left out": (CONTESTS, lambda: _without(_bid(won=True))),
    "another bid": (AGAIN, lambda: edited(_bid(won=False), lambda m: m.update(bid=m["bid"] - 1))),
    "a grant left out": (CONTESTS, lambda: _without(place("grant", cycle=4))),
    "a grant twice": (CONTESTS, lambda: _twice(place("grant", cycle=4))),
    "a grant to a node that did not ask": (
        CONTESTS,
        lambda: edited(place("grant", cycle=4), lambda m: m.update(winners=[0])),
    ),
    "an event left out": (CHANGES_HEARD, lambda: _without(place("event", step=9))),
    "an event moved": (
        CHANGES_HEARD,
        lambda: edited(place("event", step=9), lambda m: m.update(step=10)),
    ),
    "a forged event": (
        CHANGES_HEARD,
        lambda: _added("event", b'{"step":10,"change":{"what":"cut","sender":0,"receiver":1}}'),
    ),
    "an event twice": (
        "members leave, and absent nodes join",
        lambda: _twice(place("event", step=3)),
    ),
    "a forged death": (
        "members leave, and absent nodes join",
        lambda: _added("gone", b'{"what":"gone","node":1}'),
    ),
    "another belief of a node that joins": (
        "a node that joins begins",
        lambda: edited(place("event", step=6), _other_belief),
    ),
}
"""Damages of the recording: the promise that each breaks, and the damaged messages."""


def _bid(won: bool) -> int:
    """The number of the first bid that asks for a slot, and wins it or not, in a later cycle."""
    winners = {
        (m["cycle"]): m["winners"] for t, d in MESSAGES if t == "grant" and (m := json.loads(d))
    }
    return next(
        number
        for number, (topic, data) in enumerate(MESSAGES)
        if topic.startswith("bid/")
        and (said := json.loads(data))["bid"] is not None
        and (said["node"] in winners[said["cycle"]]) == won
    )


def _in_arrays(name: str, place: tuple[int, ...], value: float) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        with xarray.open_dataset(folder / ARRAYS, engine="h5netcdf") as opened:
            arrays = opened.load()
        arrays[name].values[place] += value
        write_dataset(arrays, folder / ARRAYS)

    return damage


def _other_description(**changes: Any) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        write_description(
            folder,
            describe(
                changes.pop("run", "test"), "in-process", prepare(SETUP.scenario.with_(**changes))
            ),
        )

    return damage


def _other_recording(shown: Messages, of: Setup = SETUP) -> Callable[[Path], None]:
    return lambda folder: write(folder, shown, shown, of) and None


def _all_times_zero(folder: Path) -> None:
    """Another recorder, whose steps take no time."""
    recorder = McapRecorder(
        folder / RECORDING, 3, 0.0, frame_format(SETUP.scenario), origin_of(SETUP, "test")
    )
    recorder.record(MESSAGES)
    recorder.close()


FOLDERS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "run.json of another seed": (ONE_RUN, _other_description(seed=2)),
    "run.json of another run": (ONE_RUN, _other_description(run="other")),
    "run.json of more steps": (ONE_RUN, _other_description(steps=40)),
    "a whole other recording, collected": (ONE_RUN, _other_recording(OTHER_MESSAGES, OTHER)),
    "a whole other recording under this name": (AGAIN, _other_recording(OTHER_MESSAGES)),
    "half of the steps, collected": (
        "the run went through all its steps",
        _other_recording(_cut(5)),
    ),
    "all times zero": (IN_ORDER, _all_times_zero),
    "another mean, collected": (
        AGAIN,
        lambda folder: _other_recording(edited(place("estimate/1", step=4), _one_ulp("mean")))(
            folder
        ),
    ),
    "another truth, collected": (
        AGAIN,
        lambda folder: _other_recording(edited(place("truth", step=4), _one_ulp("state")))(folder),
    ),
    "another truth in run.nc": (TRUTHS, _in_arrays("truth", (0, 4, 0), 0.5)),
    "another mean in run.nc": (ESTIMATES, _in_arrays("mean", (0, 4, 1, 0), 1e-9)),
    "another covariance in run.nc": (ESTIMATES, _in_arrays("cov", (0, 4, 1, 0, 0), 1e-9)),
    "another reading in run.nc": (READINGS, _in_arrays("readings", (0, 4, 0, 0, 0), 1e-9)),
    "another age in run.nc": ("each share that a node holds", _in_arrays("ages", (0, 4, 1), 500)),
    "other bytes in run.nc": (
        "run.nc shows the cycles",
        _in_arrays("payload_bytes", (0, 4, 0, 2), 8),
    ),
}
"""Damages of the other files, of all files at once, and of the times."""


def test_each_promise_has_its_damage():
    said = {says for says, _ in (*RECORDED.values(), *FOLDERS.values())}
    assert all(any(one.says.startswith(words) for words in said) for one in PROMISES)
    assert len(RECORDED) + len(FOLDERS) >= 46


@pytest.mark.parametrize("name", [*RECORDED, *FOLDERS])
def test_damage_is_found(tmp_path: Path, name: str, capsys):
    if name in RECORDED:
        says, damaged = RECORDED[name]
        folder = write(tmp_path, damaged())
    else:
        says, damage = FOLDERS[name]
        damage(folder := write(tmp_path, MESSAGES))
    found = broken(folder)
    if says is AGAIN:
        assert found == set()
        assert computed_again(folder).differences
    else:
        assert any(one.startswith(says) for one in found)
    with pytest.raises(SystemExit) as ended:
        main(["audit", str(folder), "--again"])
    assert ended.value.code == 1
    said = capsys.readouterr().out
    assert "DIFFERS" in said if says is AGAIN else f"BROKEN  {says}" in said


def test_a_sound_run_computed_again_is_equal(tmp_path: Path):
    found = computed_again(write(tmp_path, MESSAGES))
    assert (found.differences, found.ends, found.steps) == ((), "", 12)
    assert found.messages == len(MESSAGES)


def test_a_run_is_compared_up_to_the_first_death(tmp_path: Path):
    """Messages of later steps are no differences, however many there are."""
    first = place("measured/0", step=5)
    gone = ("event", encode(Event(5, Gone(1))))
    found = computed_again(write(tmp_path, [*MESSAGES[:first], gone, *MESSAGES[first:]]))
    assert (found.differences, found.steps) == ((), 5)
    assert found.ends == "node 1 died in step 5"


def test_each_damage_is_one_line_in_the_order_of_the_run(tmp_path: Path):
    damaged = edited(place("estimate/1", step=7), _one_ulp("mean"))
    topic, data = damaged[place("truth", step=2)]
    damaged[place("truth", step=2)] = (topic, data.replace(b"[", b"[1"))
    del damaged[place("measured/3", step=9)]
    assert computed_again(write(tmp_path, damaged)).differences == (
        "step 2, truth: another content",
        "step 7, estimate/1: another content",
        "step 9, measured/3: is not recorded",
    )


@pytest.mark.parametrize(("missing", "is_forgiven"), [(10, True), (11, False)])
def test_an_early_end_may_cut_ten_steps(missing: int, is_forgiven: bool):
    """The environment may have been killed in step 20 of 24; in any case steps are missing."""
    estimates = {(step, node): [None] for step in range(21 - missing) for node in range(4)}
    evidence: Any = SimpleNamespace(
        scenario=scenario(nodes=4, steps=24),
        in_real_time=False,
        truths=dict.fromkeys(range(21)),
        estimates=estimates,
    )
    run = Run(evidence, member_history_of(3, []), 4, 0, 1.0)
    run = run._replace(complete=_complete(run))
    (all_steps, members) = (
        one.check(run)
        for one in PROMISES
        if one.says.startswith(("the run went", "each member has"))
    )
    assert all_steps.first == f"{run.complete} of 24 steps"
    assert (members.broken == 0) == is_forgiven


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
    assert [one.jumps for one in audit(folder).around] == [False, True, False, False]
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
        (lambda folder: (folder / RECORDING).write_bytes(b"no"), "not a recording of concord"),
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
