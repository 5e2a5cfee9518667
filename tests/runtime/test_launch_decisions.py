"""Test how launcher and launcher process decide on ends, orders and reports, without a network."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from concord.nodes.tempo import Tempo
from concord.runtime.network.network_file import NetworkAddresses, read_network
from concord.runtime.processes import launcher, launcher_process
from concord.runtime.processes.job import Happened, HostPlace, Job, NodeEnded, Order
from concord.runtime.processes.launcher import NetworkFailed, run_job
from concord.runtime.processes.launcher_process import End, _at, _plans, _serve, _Watch
from concord.runtime.processes.supervisor import TRY_AGAIN, Ended
from tests.experiments.support import small

SETUP = small(nodes=3, steps=5)
JOB = Job(SETUP, "run", "run.mcap", None, sockets="/tmp/sockets")
PLACE = HostPlace(["recorder", "1"], ["tcp/a:7447", "tcp/b:7447"], {"1": "one.key"})


class Children:
    """A supervisor whose children do nothing; it tells of the ends that a test has laid down."""

    def __init__(self, *ends: Ended | int | str) -> None:
        self.ends = list(ends)
        self.pids: dict[str, int] = {}
        self.works: dict[str, partial[None]] = {}
        self.killed: list[str] = []
        self.graces: list[float] = []

    def start(self, name: str, work: partial[None]) -> None:
        self.pids[name] = 100 + len(self.pids)
        self.works[name] = work

    def kill(self, name: str) -> None:
        self.killed.append(name)

    def wait(self, _stdin: int, orders: int) -> Ended | int:
        happened = self.ends.pop(0)
        if happened == "orders":
            return orders
        assert not isinstance(happened, str)
        if isinstance(happened, Ended):
            self.pids.pop(happened.name, None)
        return happened

    def stop(self, grace_s: float) -> None:
        self.graces.append(grace_s)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[Happened]:
    told: list[Happened] = []
    monkeypatch.setattr(launcher_process, "tell", told.append)
    monkeypatch.setattr(launcher_process, "_PORT_WAIT_S", 0.0)
    return told


@pytest.fixture
def pipes() -> Iterator[tuple[int, int, int, int]]:
    both = (*os.pipe(), *os.pipe())
    yield both
    for descriptor in both:
        os.close(descriptor)


def watch_of(children: Children, orders: int, ends: int, job: Job = JOB) -> _Watch:
    (plan, *_) = _plans(job)
    watch = _Watch(children, orders, ends, job, plan, dict.fromkeys("012"))  # type: ignore[arg-type]
    for name in plan.cast:
        children.start(name, partial(print))
    return watch


LATER = {"tolerant": True}
JUDGED = {
    "a node that the network cannot do without": (("1", -9), {}, End.BROKEN, "failed"),
    "a node that may be lost": (("1", -9), LATER, None, "ended"),
    "the last node": (("1", -9), {**LATER, "alone": True}, End.BROKEN, "failed"),
    "a mistake of ours at a node": (("1", 1), LATER, End.BROKEN, "failed"),
    "the environment": (("environment", -9), LATER, End.BROKEN, "failed"),
    "the recorder when all is kept": (("recorder", 0), {}, End.DONE, "done"),
    "a node that has left": (("1", 0), LATER, None, None),
    "the last one that has left": (("1", 0), {"alone": True}, End.DONE, "done"),
    "a port that was taken at first": (("1", TRY_AGAIN), {}, End.TRY_AGAIN, None),
    "a port that a restart lacks": (("1", TRY_AGAIN), LATER, None, "started"),
    "a port that the recorder lacks": (("recorder", TRY_AGAIN), LATER, End.TRY_AGAIN, None),
}


@pytest.mark.parametrize("name", JUDGED)
def test_the_end_of_a_child_decides_whether_the_network_goes_on(name: str, told, pipes):
    (child, code), how, end, what = JUDGED[name]
    orders, give, read_ends, ends = pipes
    children = Children()
    watch = watch_of(children, orders, ends)
    if how.get("tolerant"):
        os.write(give, msgspec.json.encode(Order("tolerate")) + b"\n")
        watch._obey()
    del children.pids[child]
    if how.get("alone"):
        children.pids.clear()
    assert watch._judge(Ended(child, code)) is end
    assert [one.what for one in told] == ([what] if what else [])
    if code not in (0, TRY_AGAIN):
        who = f"node {child}" if child.isdigit() else f"the {child}"
        words = f"signal {-code}" if code < 0 else f"exit code {code}"
        assert told[0].detail == f"{who} ended with {words}"
    if what == "ended":
        reported = msgspec.json.decode(os.read(read_ends, 100), type=NodeEnded)
        assert reported == NodeEnded(1, 0) and told[0].pids == children.pids
    assert (child in children.pids) == (what == "started")


def test_orders_are_obeyed_and_a_later_life_is_told_with_its_number(told, pipes, monkeypatch):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: 0))
    orders, give, read_ends, ends = pipes
    children = Children(
        "orders", Ended("2", -9), Ended("0", -9), Ended("recorder", 0), Ended("1", -9)
    )
    watch = watch_of(children, orders, ends)
    asked = Order("tolerate"), Order("kill", 1), Order("start", 2, 4)
    os.write(give, b"".join(msgspec.json.encode(one) + b"\n" for one in asked))
    assert watch.keep() is End.DONE
    assert children.killed == ["1", "2"]
    late = children.works["2"]
    links = late.args[1]
    assert late.keywords == {"late": True} and links["2"].connect_s is None
    assert links["1"].connect_s == 60.0
    lines = os.read(read_ends, 1000).splitlines()
    found = [msgspec.json.decode(line, type=NodeEnded) for line in lines]
    assert found == [NodeEnded(2, 4), NodeEnded(0, 0)]
    assert [one.what for one in told] == ["started", "ended", "ended", "done"]


def test_a_network_is_started_from_the_recorder_on_and_stopped_in_any_case(
    told, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: 0))
    (plan, *_) = _plans(JOB)
    for ends, end, grace_s in (
        ([Ended("recorder", 0)], End.DONE, launcher_process._LEAVE_S),
        ([0], End.BROKEN, 0.0),
        ([Ended("2", TRY_AGAIN)], End.TRY_AGAIN, 0.0),
    ):
        children = Children(*ends)
        monkeypatch.setattr(launcher_process, "Supervisor", lambda children=children: children)
        told.clear()
        assert _serve(JOB, plan) is end
        assert list(children.works) == ["recorder", "environment", "0", "1", "2"]
        assert children.graces == [grace_s]
        assert told[0].what == "started" and told[0].connect == plan.connect
        nodes = [children.works[name].args[2].index for name in "012"]
        assert nodes == [0, 1, 2] and children.works["0"].args[3] is False


def test_plans_have_the_links_of_all_processes_or_of_those_on_a_host(monkeypatch):
    monkeypatch.setattr(
        launcher_process,
        "ports_from",
        lambda first, names: {name: first + place for place, name in enumerate(names)},
    )
    plans = list(_plans(JOB))
    assert len(plans) == 3 and all(one.router is None for one in plans)
    assert all(str(JOB.sockets) in end for one in plans for end in one.connect)
    (first, *_) = _plans(msgspec.structs.replace(JOB, sockets=None, port=23_450))
    assert first.cast == ["recorder", "environment", "0", "1", "2"]
    used = [end for name in first.cast for end in first.links[name].listen]
    assert used == [f"tcp/127.0.0.1:{port}" for port in (23_451, 23_450, 23_452, 23_453, 23_454)]
    dense = Job(small(nodes=12, graph="complete", steps=3), "run", "", None, sockets="/tmp/s")
    (routed, *_) = _plans(dense)
    assert routed.router is not None and routed.links["3"].connect == (routed.router,)
    (here,) = _plans(msgspec.structs.replace(JOB, place=PLACE))
    assert here == _at(PLACE) and here.cast == PLACE.cast and here.connect == PLACE.connect
    assert here.links.keys() == {"recorder", "1", "watch"}
    assert here.links["1"].keys == "one.key" and here.links["recorder"].keys is None
    assert {one.connect for one in here.links.values()} == {tuple(PLACE.connect)}
    assert here.links["watch"] == here.links["recorder"]


@pytest.mark.parametrize(
    ("job", "why"),
    [(JOB, "no sockets in /tmp/none in 3 tries"), (None, "no router answers at tcp/a:7447, tcp/b")],
)
def test_a_launcher_process_says_why_it_gives_up(
    job: Job | None, why: str, told, monkeypatch: pytest.MonkeyPatch
):
    asked = msgspec.structs.replace(
        JOB, **({"sockets": "/tmp/none"} if job else {"sockets": None, "place": PLACE})
    )
    tries: list[Job] = []
    monkeypatch.setattr(launcher_process, "hold", lambda folder: None)
    monkeypatch.setattr(launcher_process, "signal_at_parents_end", lambda number: None)
    monkeypatch.setattr(launcher_process.signal, "signal", lambda *_: None)
    monkeypatch.setattr(
        launcher_process, "_serve", lambda job, plan: tries.append(job) or End.TRY_AGAIN
    )
    for line in (msgspec.json.encode(asked) + b"\n", msgspec.json.encode(asked)):
        stdin = SimpleNamespace(buffer=SimpleNamespace(readline=lambda line=line: line))
        monkeypatch.setattr(sys, "stdin", stdin)
        launcher_process.main()
    # A line without an end is of a launcher that is gone.
    assert tries == [asked] * (3 if job else 1)
    (failed,) = told
    assert failed.what == "failed" and failed.detail.startswith(why)


# --- the launcher --------------------------------------------------------------------------------


def reporting(*told: Happened, then: str = "") -> Callable[[str], list[str]]:
    """A launcher process that tells this, whatever its job is."""
    lines = b"".join(msgspec.json.encode(one) + b"\n" for one in told)
    text = f"import os,sys,time\nsys.stdin.buffer.readline()\nos.write(1,{lines!r})\n{then}"
    return lambda _module: [sys.executable, "-S", "-E", "-c", text]


def launched(
    monkeypatch: pytest.MonkeyPatch, folder: Path, *told: Happened, then: str = ""
) -> list[Happened]:
    heard: list[Happened] = []
    monkeypatch.setattr(launcher, "fresh_command", reporting(*told, then=then))
    job = Job(SETUP, "a-run", str(folder / "run.mcap"), None, Tempo(1.0, 0.1, 0.2))
    run_job(job, folder, heard.append)
    return heard


def test_reports_are_heard_in_order_up_to_the_end(monkeypatch, tmp_path: Path):
    started = Happened("started", pids={"recorder": 7}, connect=["unixsock-stream//tmp/x"])
    told = [started, Happened("step", step=3), Happened("done"), Happened("step", step=4)]
    assert launched(monkeypatch, tmp_path, *told) == told[:2]
    assert read_network(tmp_path) == NetworkAddresses("a-run", started.connect, started.pids)


@pytest.mark.parametrize(
    ("told", "error", "why"),
    [
        (Happened("refused", detail="no port"), ValueError, "^no port$"),
        (Happened("failed", detail="node 1 ended"), NetworkFailed, "^node 1 ended$"),
        (Happened("step", step=1), NetworkFailed, "is gone; its last words are above"),
    ],
)
def test_a_network_that_ends_before_its_time_is_an_error(
    told: Happened, error: type[Exception], why: str, monkeypatch, tmp_path: Path
):
    with pytest.raises(error, match=why):
        launched(monkeypatch, tmp_path, told)


def test_a_recording_that_is_gone_or_another_ends_the_run(monkeypatch, tmp_path: Path):
    now_s = 100.0
    monkeypatch.setattr(launcher.time, "monotonic", lambda: now_s)
    file = tmp_path / "run.mcap"
    kept = launcher._Kept(str(file))

    def look_at(later_s: float) -> None:
        nonlocal now_s
        now_s += later_s
        kept.look()

    look_at(1.0)
    file.write_bytes(b"")
    look_at(1.0)
    look_at(1.0)
    file.rename(tmp_path / "moved.mcap")
    look_at(0.5)  # It looks once a second.
    with pytest.raises(NetworkFailed, match=r"run\.mcap was removed or moved"):
        look_at(0.5)
    file.write_bytes(b"another")
    with pytest.raises(NetworkFailed, match="run it again"):
        look_at(1.0)
    launcher._Kept("").look()


def test_lines_come_whole_from_a_process_that_holds_its_output_open(monkeypatch):
    monkeypatch.setattr(launcher, "_LOOK_S", 0.01)
    parts = (b"on", b"e\ntw", b"o\nrest")
    text = "".join(f"os.write(1,{part!r});time.sleep(.05);" for part in parts)
    command = [sys.executable, "-S", "-E", "-c", f"import os,time;{text}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as child:
        assert list(launcher._reports(child, launcher._Kept(""))) == [b"one", b"two"]
