"""What each forked process of a network does, wherever the network is."""

import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from nodes.disk import NotWritten
from nodes.failures import Deserted, Disagreement
from nodes.links import RECORDER, WATCH, Links, peers_of
from nodes.management import Management
from nodes.membership import Membership
from nodes.node_state import NodeConfig
from nodes.process import run_node
from nodes.realtime_process import run_node_in_real_time
from nodes.recorder_process import run_recorder
from nodes.recording import McapRecorder
from nodes.supervisor import TRY_AGAIN
from nodes.whole_steps import WholeSteps
from nodes.world_process import run_world
from nodes.zenoh_transport import LinkError, start_router
from scenarios.build import build_world
from scenarios.job import Happened, Job, Order
from scenarios.script import script_of
from scenarios.setup import complete_settings, fingerprint

_PROGRESS_PERIOD_S = 0.05


def be_router(endpoint: str) -> None:
    """Pass on what others say, until the supervisor ends it."""

    def route() -> None:
        session = start_router(endpoint)
        signal.pause()
        session.close()

    _joining(route)


def be_recorder(job: Job, links: dict[str, Links], tell: Callable[[Happened], None]) -> None:
    """Keep what is said, and let others hear it."""
    scenario = job.setup.scenario
    try:
        recorder = McapRecorder(Path(job.recording), scenario.rounds, job.setup.time_step_s)
        steps = WholeSteps(scenario.nodes, scenario.rounds)
        _joining(partial(run_recorder, job.run, links[RECORDER], links[WATCH], recorder, steps))
    except NotWritten as error:
        tell(Happened("failed", detail=str(error)))
        sys.exit(1)


def be_world(job: Job, links: Links, tell: Callable[[Happened], None], orders: int) -> None:
    """Move the plant; what it wants of whoever starts processes goes to the pipe `orders`."""
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
    config = build_world(job.setup)
    management = Management(
        kill=lambda node: give(Order("kill", node)),
        start=lambda node: give(Order("start", node)),
        keeps_nodes=job.place is None,
        check=partial(complete_settings, job.setup),
        on_step=on_step,
        setup=msgspec.json.encode(job.setup),
    )
    script = script_of(job.setup.scenario)
    known = (config, fingerprint(job.setup), management, script, job.tempo)
    work = partial(run_world, job.run, links, *known)
    try:
        _joining(work)
    except (Deserted, Disagreement) as end:
        tell(Happened("failed", detail=str(end)))
        sys.exit(1)


def be_node(job: Job, links: Links, config: NodeConfig, late: bool = False) -> None:
    """Be one node; `late` where the network may run already."""
    peers = peers_of(config.index, job.setup.neighbours)
    patience_s = None if job.place is None else job.place.patience_s
    membership = Membership(job.run, links, config, peers, fingerprint(job.setup), late, patience_s)
    if job.tempo is None:
        _joining(partial(run_node, membership))
    else:
        _joining(partial(run_node_in_real_time, membership, job.tempo))


def _joining(work: Callable[[], None]) -> None:
    """Do `work`; a link that cannot be opened means that somebody took a port: try again."""
    try:
        work()
    except LinkError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(TRY_AGAIN)
