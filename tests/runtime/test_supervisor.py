"""Test the forks of children, the reports of their ends, and the cleanup, in fresh processes."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from tests.processes import PROC, family, holds_within

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]

BEGINNING = """
import os, signal, sys, time
from concord.runtime.processes.supervisor import TRY_AGAIN, Ended, Supervisor
quiet, _hold = os.pipe()
def say(*words):
    sys.stdout.write(" ".join(map(str, words)) + "\\n")
    sys.stdout.flush()
def ready():
    sys.stderr.write("ready\\n")
    sys.stderr.flush()
supervisor = Supervisor()
"""


def script(text: str, folder: Path):
    return family([sys.executable, "-c", BEGINNING + text], folder)


def test_the_end_of_each_child_is_told_by_name(tmp_path: Path):
    text = """
def fail():
    raise RuntimeError("out of luck")
supervisor.start("good", lambda: None)
supervisor.start("bad", fail)
supervisor.start("again", lambda: sys.exit(TRY_AGAIN))
supervisor.start("killed", lambda: os.kill(os.getpid(), signal.SIGKILL))
supervisor.start("asked", lambda: os.kill(os.getpid(), signal.SIGTERM))
assert set(supervisor.pids) == {"good", "bad", "again", "killed", "asked"}
for _ in range(5):
    say(*supervisor.wait(quiet))
assert supervisor.pids == {}
"""
    with script(text, tmp_path) as run:
        code, out, err = run.end(10)
    assert code == 0
    ends = dict(line.split() for line in out.splitlines())
    assert ends == {"good": "0", "bad": "1", "again": "75", "killed": "-9", "asked": "-15"}
    # A function that is not of concord is named with its last line.
    assert "in fail: RuntimeError: out of luck" in err and "Traceback" not in err


def test_a_readable_descriptor_ends_the_wait(tmp_path: Path):
    text = """
read, write = os.pipe()
supervisor.start("sleeper", signal.pause)
supervisor.start("writer", lambda: (os.write(write, b"x"), time.sleep(0.2)))
first = supervisor.wait(quiet, read)
say(first == read)
supervisor.stop()
"""
    with script(text, tmp_path) as run:
        code, out, _ = run.end(10)
        assert (code, out) == (0, "True\n")
        assert run.gone_within(0)


@pytest.mark.parametrize(
    ("work", "at_most_s"),
    [
        ("signal.pause()", 1.0),
        ("(signal.signal(signal.SIGTERM, signal.SIG_IGN), time.sleep(60))", 3.0),
        ("os.kill(os.getpid(), signal.SIGSTOP)", 3.0),
    ],
    ids=["polite", "deaf", "stopped"],
)
def test_stop_leaves_nobody(tmp_path: Path, work: str, at_most_s: float):
    text = f"""
for number in range(3):
    supervisor.start(str(number), lambda: {work})
time.sleep(0.3)
before = time.monotonic()
supervisor.stop()
say(time.monotonic() - before, supervisor.pids)
"""
    with script(text, tmp_path) as run:
        code, out, _ = run.end(10)
        seconds, pids = out.split()
        assert (code, pids) == (0, "{}")
        assert float(seconds) < at_most_s
        assert run.gone_within(0)


def test_who_leaves_by_himself_is_given_time(tmp_path: Path):
    text = """
supervisor.start("slow", lambda: (time.sleep(0.3), say("done")))
supervisor.stop(5.0)
"""
    with script(text, tmp_path) as run:
        assert run.end(10)[:2] == (0, "done\n")


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_children_do_not_outlive_their_parent(tmp_path: Path, how: signal.Signals):
    text = """
for number in range(4):
    supervisor.start(str(number), lambda: time.sleep(60))
ready()
supervisor.wait(quiet)
"""
    with script(text, tmp_path) as run:
        run.await_line("ready")
        assert len(run.descendants()) == 4
        run.send(how)
        run.process.wait(3)
        assert run.gone_within(1)


def test_ctrl_c_is_for_the_parent_alone(tmp_path: Path):
    """A terminal sends SIGINT to everyone; children wait for their parent's word."""
    text = """
supervisor.start("child", lambda: (ready(), time.sleep(60)))
supervisor.wait(quiet)
"""
    with script(text, tmp_path) as run:
        run.await_line("ready")
        (child,) = run.descendants()
        os.kill(child, signal.SIGINT)
        time.sleep(0.2)
        assert run.descendants() == [child]
        run.send(signal.SIGKILL)
        assert holds_within(1, lambda: not run.descendants())


def test_a_child_is_killed_by_its_name(tmp_path: Path):
    text = """
supervisor.start("1", lambda: time.sleep(60))
supervisor.start("2", lambda: time.sleep(60))
supervisor.kill("1")
supervisor.kill("nobody")
say(*supervisor.wait(quiet))
say(*supervisor.pids)
supervisor.stop()
"""
    with script(text, tmp_path) as run:
        assert run.end(10)[:2] == (0, "1 -9\n2\n")
