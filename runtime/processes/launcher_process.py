"""The clean parent of a network's processes on this host, started as a module: it forks them.

It reads a `Job` from standard input and forks recorder, environment and nodes, or those that belong
on this host. It reports on standard output, one JSON object a line. When standard input closes, it
ends everything.
"""

import contextlib
import gc
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from enum import Enum
from functools import partial

import msgspec

from concord.nodes.node_state import NodeConfig
from concord.runtime.network.links import (
    ENVIRONMENT,
    RECORDER,
    ROUTER,
    WATCH,
    ZenohEndpoints,
    free_ports,
    links_to_routers,
    names,
    on_loopback,
    plan_links,
    ports_from,
    subscribers_endpoints,
)
from concord.runtime.network.sockets import hold, in_folder
from concord.runtime.processes.job import Happened, HostPlace, Job, NodeEnded, Order
from concord.runtime.processes.roles import be_environment, be_node, be_recorder, be_router
from concord.runtime.processes.supervisor import (
    TRY_AGAIN,
    Ended,
    Supervisor,
    signal_at_parents_end,
)
from concord.scenarios.build import build_node

_LAUNCH_TRIES = 3
_LEAVE_S = 1.0
_PORT_WAIT_S = 0.05


def tell(happened: Happened) -> None:
    """One line on standard output, written at once and whole."""
    # A launcher that was killed listens no more; the lifeline ends us then.
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), msgspec.json.encode(happened) + b"\n")


def main() -> None:
    """Serve one job."""
    # A process that is stopped goes on, and finds its standard input closed.
    signal_at_parents_end(signal.SIGCONT)
    # Ctrl-C is for the launcher, also where a program signals the whole group.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line = sys.stdin.buffer.readline()
    if not line.endswith(b"\n"):
        # The launcher is gone before it said what to do.
        return
    job = msgspec.json.decode(line, type=Job)
    if job.sockets is not None:
        # The children inherit the lock.
        hold(job.sockets)
    try:
        for plan in _plans(job):
            if _serve(job, plan) is not End.TRY_AGAIN:
                return
        if job.place is None:
            where = "free ports" if job.sockets is None else f"sockets in {job.sockets}"
            tell(Happened("failed", detail=f"no {where} in {_LAUNCH_TRIES} tries"))
        else:
            tell(Happened("failed", detail=f"no router answers at {', '.join(job.place.connect)}"))
    except ValueError as error:
        tell(Happened("refused", detail=str(error)))
    finally:
        if job.sockets is not None:
            # The launcher may be gone, and its folder of sockets with us alone.
            shutil.rmtree(job.sockets, ignore_errors=True)


class _Plan(msgspec.Struct):
    """The processes of this host, the links of each, and where subscribers connect."""

    cast: list[str]
    links: dict[str, ZenohEndpoints]
    connect: list[str]
    router: str | None = None


def _plans(job: Job) -> Iterator[_Plan]:
    """One after the other, until one can be carried out."""
    if job.place is not None:
        yield _at(job.place)
        return
    everybody = [RECORDER, ENVIRONMENT, *map(str, range(job.setup.scenario.nodes))]
    wanted = names(job.setup.neighbours)
    for _ in range(_LAUNCH_TRIES):
        if job.sockets is not None:
            at = in_folder(job.sockets, wanted)
        else:
            at = on_loopback(ports_from(job.port, wanted) if job.port else free_ports(wanted))
        links = plan_links(job.setup.neighbours, at)
        yield _Plan(everybody, links, subscribers_endpoints(at), at.get(ROUTER))


def _at(place: HostPlace) -> _Plan:
    """Plan one of several hosts, where every process is a client of a router."""
    links = {
        name: links_to_routers(place.connect, place.keys.get(name))
        for name in (*place.cast, RECORDER)
    }
    return _Plan(place.cast, {**links, WATCH: links[RECORDER]}, place.connect)


class End(Enum):
    """How one try at running the network ended."""

    DONE = "done"
    BROKEN = "broken"
    TRY_AGAIN = "a link could not be opened"


def _serve(job: Job, plan: _Plan) -> End:
    """Run the network, or its part that is here, once."""
    # Built before the fork, so that the children share the pages.
    nodes = {name: build_node(job.setup, int(name)) for name in plan.cast if name.isdigit()}
    # A collection in a child would write into all of them.
    gc.freeze()
    supervisor = Supervisor()
    orders, give_orders = os.pipe()
    ends, tell_ends = os.pipe()
    end = End.BROKEN
    try:
        if plan.router is not None:
            supervisor.start(ROUTER, partial(be_router, plan.router))
        for name in plan.cast:
            if name == RECORDER:
                supervisor.start(name, partial(be_recorder, job, plan.links, tell))
            elif name == ENVIRONMENT:
                link = plan.links[name]
                work = partial(be_environment, job, link, tell, give_orders, ends)
                supervisor.start(name, work)
            else:
                # On another host the network may run already.
                late = job.place is not None
                work = partial(be_node, job, plan.links, nodes[name], late)
                supervisor.start(name, work)
        tell(Happened("started", pids=supervisor.pids, connect=plan.connect))
        end = _Watch(supervisor, orders, tell_ends, job, plan, nodes).keep()
        return end
    finally:
        supervisor.stop(_LEAVE_S if end is End.DONE else 0.0)
        for descriptor in (orders, give_orders, ends, tell_ends):
            os.close(descriptor)


class _Watch:
    """Waits for the recorder's end or a failure, and obeys the environment process."""

    def __init__(
        self,
        supervisor: Supervisor,
        orders: int,
        ends: int,
        job: Job,
        plan: _Plan,
        nodes: dict[str, NodeConfig],
    ) -> None:
        self._supervisor, self._orders, self._ends = supervisor, orders, ends
        self._job, self._plan, self._nodes = job, plan, nodes
        # How often the environment has asked for each node's start.
        self._lives: dict[int, int] = {}
        # Until the network is ready it needs every node; on one of several hosts that is unknown.
        self._tolerant = ENVIRONMENT not in plan.cast

    def keep(self) -> End:
        """Run until the network ends."""
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
        """Judge the end of a child: how the network ends, or None if it goes on."""
        is_node = ended.name.isdigit()
        if is_node and self._tolerant and ended.code == TRY_AGAIN and self._job.place is None:
            # Its port was not free yet.
            time.sleep(_PORT_WAIT_S)
            self._start(int(ended.name))
            return None
        if ended.code == TRY_AGAIN:
            return End.TRY_AGAIN
        nobody_left = not self._supervisor.pids
        if ended.code != 0:
            who = f"node {ended.name}" if is_node else f"the {ended.name}"
            detail = f"{who} ended with {_in_words(ended.code)}"
            # A node that was killed is a loss; one that has failed is a mistake of ours.
            if is_node and self._tolerant and ended.code < 0 and not nobody_left:
                self._tell("ended", detail)
                self._report(int(ended.name))
                return None
            tell(Happened("failed", detail=detail))
            return End.BROKEN
        if ended.name == RECORDER or nobody_left:
            tell(Happened("done"))
            return End.DONE
        return None

    def _report(self, node: int) -> None:
        """Tell the environment process of a node's end, unless its next process is there."""
        if str(node) not in self._supervisor.pids:
            life = self._lives.get(node, 0)
            os.write(self._ends, msgspec.json.encode(NodeEnded(node, life)) + b"\n")

    def _obey(self) -> None:
        for line in os.read(self._orders, 4096).splitlines():
            order = msgspec.json.decode(line, type=Order)
            match order.what:
                case "tolerate":
                    self._tolerant = True
                case "kill":
                    self._supervisor.kill(str(order.node))
                case "start":
                    self._lives[order.node] = order.life
                    self._start(order.node)

    def _tell(self, what: str, detail: str = "") -> None:
        pids = self._supervisor.pids
        tell(Happened(what, pids=pids, connect=self._plan.connect, detail=detail))

    def _start(self, node: int) -> None:
        name = str(node)
        # It may be there still, and hang.
        self._supervisor.kill(name)
        own = self._plan.links[name]._replace(connect_s=None)
        links = {**self._plan.links, name: own}
        work = partial(be_node, self._job, links, self._nodes[name], late=True)
        self._supervisor.start(name, work)
        self._tell("started")


def _in_words(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


if __name__ == "__main__":
    main()
