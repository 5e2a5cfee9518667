"""Test the processor time of processes, read from outside of them."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.processor import spent_s

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
WORK_S = 0.5
# The kernel rounds each of utime, stime, cutime and cstime down to whole ticks.
LOST_S = 4 / os.sysconf("SC_CLK_TCK")
BUSY = f"import time\nwhile time.process_time() < {WORK_S}: pass\n"
PARENT = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {BUSY!r}])\n"


def test_a_process_costs_what_it_and_its_children_worked():
    code = f"{PARENT}print(flush=True)\ninput()"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with process:
        assert process.stdout
        assert process.stdout.readline()
        # A stopped process uses no processor time between two readings.
        process.send_signal(signal.SIGSTOP)
        os.waitpid(process.pid, os.WUNTRACED)
        assert WORK_S - LOST_S <= spent_s([process.pid]) < 6 * WORK_S
        assert spent_s([process.pid, process.pid]) == 2 * spent_s([process.pid])
        process.kill()


def test_who_has_left_costs_nothing_any_more():
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    assert spent_s([process.pid]) == 0.0
