"""The clean parent of a network on this machine: `python -m scenarios.zygote` forks its processes.

It reads a `Job` from standard input, forks recorder, world and nodes, and says on standard output,
one JSON object a line, what happens. When standard input closes it ends everything.
"""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from enum import Enum
from functools import partial
from pathlib import Path

import msgspec

from nodes.links import (
    RECORDER,
    ROUTER,
    WORLD,
    Links,
    free_ports,
    names,
    peers_of,
    plan_links,
    ports_from,
)
from nodes.process import run_node, run_recorder, run_world
from nodes.recording import McapRecorder
from nodes.state_machine import NodeConfig
from nodes.supervisor import TRY_AGAIN, Supervisor
from nodes.zenoh_transport import LinkError, start_router
from scenarios.build import build_node, build_world
from scenarios.job import Happened, Job
from scenarios.setup import fingerprint

_LAUNCH_TRIES = 3
_PROGRESS_PERIOD_S = 0.05
_LEAVE_S = 1.0


def tell(happened: Happened) -> None:
    """One line on standard output, written at once and whole."""
    # Nobody listens any more when the launcher was killed; the lifeline ends us then.
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), msgspec.json.encode(happened) + b"\n")


def main() -> None:
    """Serve one job."""
    line = sys.stdin.buffer.readline()
    if not line.endswith(b"\n"):
        # The launcher is gone before it said what to do.
        return
    job = msgspec.json.decode(line, type=Job)
    try:
        for _ in range(_LAUNCH_TRIES):
            wanted = names(job.setup.neighbours)
            ports = free_ports(wanted) if job.port is None else ports_from(job.port, wanted)
            if _serve(job, ports) is not End.TRY_AGAIN:
                return
        tell(Happened("failed", detail=f"no free ports in {_LAUNCH_TRIES} tries"))
    except ValueError as error:
        tell(Happened("refused", detail=str(error)))


class End(Enum):
    """How one try at running the network ended."""

    DONE = "done"
    BROKEN = "broken"
    TRY_AGAIN = "somebody else took a port"


def _serve(job: Job, ports: dict[str, int]) -> End:
    """Run the network once."""
    links = plan_links(job.setup.neighbours, ports)
    # Built before the fork, so that the children share the pages.
    nodes = [build_node(job.setup, node) for node in range(job.setup.scenario.nodes)]
    supervisor = Supervisor()
    started = time.monotonic()
    end = End.BROKEN
    try:
        if ROUTER in ports:
            supervisor.start(ROUTER, partial(_route, f"tcp/127.0.0.1:{ports[ROUTER]}"))
        supervisor.start(RECORDER, partial(_record, job, links[RECORDER]))
        supervisor.start(WORLD, partial(_be_world, job, links[WORLD], started))
        for config in nodes:
            name = str(config.index)
            supervisor.start(name, partial(_be_node, job, links[name], config))
        tell(Happened("started", pids=supervisor.pids))
        end = _watch(supervisor)
        return end
    finally:
        supervisor.stop(_LEAVE_S if end is End.DONE else 0.0)


def _watch(supervisor: Supervisor) -> End:
    """Wait for the recorder's good end, or for trouble."""
    while True:
        ended = supervisor.wait(sys.stdin.fileno())
        if ended is None:
            return End.BROKEN
        if ended.code == TRY_AGAIN:
            return End.TRY_AGAIN
        if ended.code != 0:
            who = f"node {ended.name}" if ended.name.isdigit() else f"the {ended.name}"
            tell(Happened("failed", detail=f"{who} ended with {_in_words(ended.code)}"))
            return End.BROKEN
        if ended.name == RECORDER:
            tell(Happened("done"))
            return End.DONE


def _in_words(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _route(endpoint: str) -> None:
    def route() -> None:
        session = start_router(endpoint)
        # Until the supervisor ends it.
        signal.pause()
        session.close()

    _joining(route)


def _record(job: Job, links: Links) -> None:
    scenario = job.setup.scenario
    recorder = McapRecorder(Path(job.recording), scenario.rounds, job.setup.time_step_s)
    estimates = scenario.nodes * scenario.steps
    _joining(partial(run_recorder, job.run, links, recorder, estimates))


def _be_world(job: Job, links: Links, started: float) -> None:
    told = 0.0

    def on_step(step: int) -> None:
        nonlocal told
        now = time.monotonic()
        if step == 0:
            tell(Happened("ready", seconds=now - started))
        elif now - told > _PROGRESS_PERIOD_S or step == job.setup.scenario.steps:
            told = now
            tell(Happened("step", step=step, seconds=now - started))

    # Built here: the design of a controller loads much that no node needs.
    config = build_world(job.setup)
    _joining(partial(run_world, job.run, links, config, fingerprint(job.setup), on_step))


def _be_node(job: Job, links: Links, config: NodeConfig) -> None:
    peers = peers_of(config.index, job.setup.neighbours)
    _joining(partial(run_node, job.run, links, config, peers, fingerprint(job.setup)))


def _joining(work: Callable[[], None]) -> None:
    """Do `work`; a link that cannot be opened means that somebody took a port: try again."""
    try:
        work()
    except LinkError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(TRY_AGAIN)


if __name__ == "__main__":
    main()
