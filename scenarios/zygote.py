"""The clean parent of a network on this machine: `python -m scenarios.zygote` forks its processes.

It reads a `Job` from standard input, forks recorder, world and nodes, and says on standard output,
one JSON object a line, what happens. When standard input closes it ends everything.
"""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from enum import Enum
from functools import partial
from pathlib import Path

import msgspec

from nodes.links import (
    RECORDER,
    ROUTER,
    WATCH,
    WORLD,
    Links,
    free_ports,
    names,
    peers_of,
    plan_links,
    ports_from,
    watchers_endpoints,
)
from nodes.node_state import NodeConfig
from nodes.process import run_node, run_recorder
from nodes.realtime_process import run_node_in_real_time
from nodes.recording import McapRecorder
from nodes.supervisor import TRY_AGAIN, Ended, Supervisor
from nodes.world_process import Deserted, Management, run_world
from nodes.zenoh_transport import LinkError, start_router
from scenarios.build import build_node, build_world
from scenarios.job import Happened, Job, Order
from scenarios.script import script_of
from scenarios.setup import complete_settings, fingerprint

_LAUNCH_TRIES = 3
_PROGRESS_PERIOD_S = 0.05
_LEAVE_S = 1.0
_PORT_WAIT_S = 0.05


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
    orders, give_orders = os.pipe()
    end = End.BROKEN
    try:
        if ROUTER in ports:
            supervisor.start(ROUTER, partial(_route, f"tcp/127.0.0.1:{ports[ROUTER]}"))
        supervisor.start(RECORDER, partial(_record, job, links))
        supervisor.start(WORLD, partial(_be_world, job, links[WORLD], started, give_orders))
        for config in nodes:
            name = str(config.index)
            supervisor.start(name, partial(_be_node, job, links[name], config))
        connect = watchers_endpoints(ports)
        tell(Happened("started", pids=supervisor.pids, connect=connect))
        end = _Watch(supervisor, orders, job, links, nodes, connect).keep()
        return end
    finally:
        supervisor.stop(_LEAVE_S if end is End.DONE else 0.0)
        os.close(orders)
        os.close(give_orders)


class _Watch:
    """Waits for the recorder's good end, or for trouble; does what the world wants of nodes."""

    def __init__(
        self,
        supervisor: Supervisor,
        orders: int,
        job: Job,
        links: dict[str, Links],
        nodes: Sequence[NodeConfig],
        connect: list[str],
    ) -> None:
        self._connect = connect
        self._supervisor, self._orders = supervisor, orders
        self._job, self._links, self._nodes = job, links, nodes
        # Until the network is ready it needs every node.
        self._tolerant = False

    def keep(self) -> End:
        """Until the end."""
        while True:
            happened = self._supervisor.wait(sys.stdin.fileno(), self._orders)
            if happened == self._orders:
                self._obey()
                continue
            if isinstance(happened, int):
                return End.BROKEN
            end = self._judge(happened)
            if end is not None:
                return end

    def _judge(self, ended: Ended) -> End | None:
        """What the end of a child means for the network; None that it goes on."""
        is_node = ended.name.isdigit()
        if is_node and self._tolerant and ended.code == TRY_AGAIN:
            # Its port was not free yet.
            time.sleep(_PORT_WAIT_S)
            self._start(int(ended.name))
            return None
        if ended.code == TRY_AGAIN:
            return End.TRY_AGAIN
        if ended.code != 0:
            who = f"node {ended.name}" if is_node else f"the {ended.name}"
            detail = f"{who} ended with {_in_words(ended.code)}"
            # A node that was killed is a loss; one that has failed is a mistake of ours.
            if is_node and self._tolerant and ended.code < 0:
                self._tell("ended", detail)
                return None
            tell(Happened("failed", detail=detail))
            return End.BROKEN
        if ended.name == RECORDER:
            tell(Happened("done"))
            return End.DONE
        return None

    def _obey(self) -> None:
        for line in os.read(self._orders, 4096).splitlines():
            order = msgspec.json.decode(line, type=Order)
            match order.what:
                case "tolerate":
                    self._tolerant = True
                case "kill":
                    self._supervisor.kill(str(order.node))
                case "start":
                    self._start(order.node)

    def _tell(self, what: str, detail: str = "") -> None:
        pids = self._supervisor.pids
        tell(Happened(what, pids=pids, connect=self._connect, detail=detail))

    def _start(self, node: int) -> None:
        name = str(node)
        # It may be there still, and hang.
        self._supervisor.kill(name)
        links = self._links[name]._replace(connect_s=None)
        work = partial(_be_node, self._job, links, self._nodes[node], late=True)
        self._supervisor.start(name, work)
        self._tell("started")


def _in_words(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _route(endpoint: str) -> None:
    def route() -> None:
        session = start_router(endpoint)
        # Until the supervisor ends it.
        signal.pause()
        session.close()

    _joining(route)


def _record(job: Job, links: dict[str, Links]) -> None:
    recorder = McapRecorder(Path(job.recording), job.setup.scenario.rounds, job.setup.time_step_s)
    _joining(partial(run_recorder, job.run, links[RECORDER], links[WATCH], recorder))


def _be_world(job: Job, links: Links, started: float, orders: int) -> None:
    told = 0.0

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
        check=partial(complete_settings, job.setup),
        on_step=on_step,
        setup=msgspec.json.encode(job.setup),
    )
    script = script_of(job.setup.scenario)
    known = (config, fingerprint(job.setup), management, script, job.tempo)
    work = partial(run_world, job.run, links, *known)
    try:
        _joining(work)
    except Deserted as end:
        tell(Happened("failed", detail=str(end)))
        sys.exit(1)


def _be_node(job: Job, links: Links, config: NodeConfig, late: bool = False) -> None:
    peers = peers_of(config.index, job.setup.neighbours)
    known = (job.run, links, config, peers, fingerprint(job.setup))
    if job.tempo is None:
        _joining(partial(run_node, *known, late))
    else:
        _joining(partial(run_node_in_real_time, *known, job.tempo))


def _joining(work: Callable[[], None]) -> None:
    """Do `work`; a link that cannot be opened means that somebody took a port: try again."""
    try:
        work()
    except LinkError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(TRY_AGAIN)


if __name__ == "__main__":
    main()
