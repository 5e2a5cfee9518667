"""The roles of forked processes: router, recorder, environment and node."""

import math
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from concord.disk import NotWritten
from concord.nodes.node_state import NodeConfig
from concord.runtime.network.links import RECORDER, WATCH, ZenohEndpoints, endpoints_below
from concord.runtime.network.zenoh_transport import LinkError, start_router
from concord.runtime.processes.job import Happened, Job, Order
from concord.runtime.processes.node.lockstep import LockstepNode
from concord.runtime.processes.node.membership import Membership
from concord.runtime.processes.node.process import run_node
from concord.runtime.processes.supervisor import TRY_AGAIN
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.preparation import complete_settings, fingerprint
from concord.scenarios.script import script_of

_PROGRESS_PERIOD_S = 0.05
_LONGEST_WAIT_STEPS = 8


def be_router(endpoint: str) -> None:
    """Pass on what others say, until the supervisor ends it."""

    def route() -> None:
        session = start_router(endpoint)
        signal.pause()
        session.close()

    _joining(route)


def be_recorder(
    job: Job, links: dict[str, ZenohEndpoints], tell: Callable[[Happened], None]
) -> None:
    """Keep what is said, and let others hear it."""
    # Only here, after the fork: no node needs the recorder.
    from concord.runtime.processes.recorder.process import run_recorder
    from concord.runtime.recording import McapRecorder, origin_of
    from concord.runtime.whole_steps import WholeSteps

    scenario = job.setup.scenario
    try:
        frames = frame_format(scenario)
        recorder = McapRecorder(
            Path(job.recording),
            scenario.rounds,
            job.setup.time_step_s,
            frames,
            origin_of(job.setup, job.run),
        )
        # In real time a node that hangs must not hold up a page.
        wait = {} if job.tempo is None else {"longest_wait_steps": _LONGEST_WAIT_STEPS}
        steps = WholeSteps(scenario.nodes, scenario.rounds, frames, **wait)
        known = (links[RECORDER], links[WATCH], recorder, steps)
        _joining(partial(run_recorder, job.run, *known, partial(_tell_repeats, tell)))
    except NotWritten as error:
        tell(Happened("failed", detail=str(error)))
        sys.exit(1)


def _tell_repeats(tell: Callable[[Happened], None], repeated: int) -> None:
    tell(Happened("repeated", count=repeated))


def be_environment(
    job: Job, links: ZenohEndpoints, tell: Callable[[Happened], None], orders: int, ends: int
) -> None:
    """Run the environment.

    Orders to the launcher process go to the pipe `orders`; it reports ends of nodes by `ends`.
    """
    # Only here, after the fork: no node needs the environment.
    from concord.runtime.processes.environment.decisions import Deserted, Disagreement
    from concord.runtime.processes.environment.pacing import Lockstep, RealTime
    from concord.runtime.processes.environment.process import Management, run_environment
    from concord.scenarios.build import build_environment

    started, told = time.monotonic(), 0.0

    def give(order: Order) -> None:
        os.write(orders, msgspec.json.encode(order) + b"\n")

    def on_step(step: int) -> None:
        nonlocal told
        now = time.monotonic()
        if step == 0:
            give(Order("tolerate"))
            tell(Happened("ready", seconds=now - started))
        elif now - told > _PROGRESS_PERIOD_S or step == job.setup.scenario.steps:
            told = now
            tell(Happened("step", step=step, seconds=now - started))

    # Built here: the design of a controller loads much that no node needs.
    config = build_environment(job.setup)
    management = Management(
        kill=lambda node: give(Order("kill", node)),
        start=lambda node, life: give(Order("start", node, life)),
        ends=ends,
        keeps_nodes=job.place is None,
        check=partial(complete_settings, job.setup),
        on_step=on_step,
        setup=msgspec.json.encode(job.setup),
    )
    script = script_of(job.setup.scenario)
    pacing = Lockstep(job.begins_paused) if job.tempo is None else RealTime(job.tempo)
    known = (config, fingerprint(job.setup), management, pacing, script)
    work = partial(run_environment, job.run, links, *known)
    try:
        _joining(work)
    except (Deserted, Disagreement) as end:
        tell(Happened("failed", detail=str(end)))
        sys.exit(1)


def be_node(
    job: Job, links: dict[str, ZenohEndpoints], config: NodeConfig, late: bool = False
) -> None:
    """Be one node; `late` where the network may run already."""
    index = config.index
    membership = Membership(
        job.run,
        links[str(index)],
        config,
        fingerprint(job.setup),
        late,
        endpoints_below(links, index),
        math.inf if job.place is None else job.place.peer_timeout_s,
    )
    if job.tempo is None:
        _joining(lambda: run_node(membership, LockstepNode(membership)))
        return
    # Only here, after the fork: a node in lockstep needs no timetable.
    from concord.runtime.processes.node.real_time import RealTimeNode

    tempo = job.tempo
    _joining(lambda: run_node(membership, RealTimeNode(membership, tempo=tempo)))


def _joining(work: Callable[[], None]) -> None:
    """Do `work`; a link that cannot be opened means that a port was taken: try again."""
    try:
        work()
    except LinkError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(TRY_AGAIN)
