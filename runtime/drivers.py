"""The ways to run a setup: each leaves the messages of the run in a recorder or a file."""

import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from concord.nodes.commands import Scripted
from concord.nodes.tempo import Tempo
from concord.runtime import in_process
from concord.runtime.processes.job import Happened
from concord.runtime.recording import McapRecorder, MemoryRecorder, Recorder, origin_of
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.preparation import complete_settings
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.user.faults import user_faults


class RunPace(NamedTuple):
    """How fast a run went. For processes: `ready_s` from the first fork to the first heartbeat, and
    the messages that processes repeated, as they might have been lost."""

    steps_per_second: float | None
    ready_s: float | None
    repeated_messages: int | None = None


Driver = Callable[[Setup, str, Path, int | None, Callable[[int], None]], RunPace]


def in_this_process(
    setup: Setup, run: str, recording: Path, _port: int | None, on_step: Callable[[int], None]
) -> RunPace:
    """Run all nodes and the environment in this process."""
    frames = frame_format(setup.scenario)
    origin = origin_of(setup, run)
    recorder = McapRecorder(recording, setup.scenario.rounds, setup.time_step_s, frames, origin)
    started = time.monotonic()
    try:
        drive(setup, recorder, on_step)
    finally:
        recorder.close()
    return RunPace(setup.scenario.steps / (time.monotonic() - started), None)


def in_memory(setup: Setup) -> list[tuple[str, bytes]]:
    """The messages of an in-process run."""
    recorder = MemoryRecorder()
    drive(setup, recorder, lambda _: None)
    return recorder.messages


@user_faults()
def drive(
    setup: Setup,
    recorder: Recorder,
    on_step: Callable[[int], None],
    script: Sequence[Scripted] | None = None,
) -> None:
    """Run a setup in this process, with the changes of its scenario or of a `script`.

    Raises:
        UserFault: a function of the user failed in the run.
    """
    nodes = [build_node(setup, node) for node in range(setup.scenario.nodes)]
    in_process.run(
        build_environment(setup),
        nodes,
        recorder,
        on_step=on_step,
        script=script_of(setup.scenario) if script is None else script,
        check=partial(complete_settings, setup),
    )


def over_processes(
    setup: Setup,
    run: str,
    recording: Path,
    port: int | None,
    on_step: Callable[[int], None],
    tempo: Tempo | None = None,
    on_paused: Callable[[], None] | None = None,
) -> RunPace:
    """One operating-system process per node, messages over zenoh, in lockstep; with a
    `tempo` in real time. In lockstep, a network with `on_paused` waits for a command before its
    first step; it is called when the network is ready for one.

    Raises:
        NetworkFailed: a process died.
        ValueError: the port cannot be used.
    """
    ready_s = last_s = 0.0
    repeated = 0

    def on_event(happened: Happened) -> None:
        nonlocal ready_s, last_s, repeated
        match happened.what:
            case "ready":
                ready_s = happened.seconds
                if on_paused is not None:
                    on_paused()
            case "step":
                last_s = happened.seconds
                on_step(happened.step)
            case "repeated":
                repeated += happened.count
            case "ended":
                sys.stderr.write(f"{happened.detail}; the others go on\n")

    # Only here: a run in process starts none.
    from concord.runtime.processes.launcher import run_processes

    run_processes(setup, run, recording, port, on_event, tempo, on_paused is not None)
    return RunPace(setup.scenario.steps / (last_s - ready_s), ready_s, repeated)


# Drivers that give equal bits.
DRIVERS: dict[str, Driver] = {"in-process": in_this_process, "processes": over_processes}
