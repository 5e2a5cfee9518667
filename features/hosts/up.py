"""A network on several hosts over ssh: one log, commands by line, and one end for all."""

import os
import selectors
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import IO

from concord.features.hosts.plan import NetworkPlan, Process
from concord.features.hosts.remote import Remote, copy_files, remote_folder
from concord.runtime.network.links import ENVIRONMENT

RESULTS = "results"
_LISTENS = "router at "
# Routers answer within this time; commands that are asked to end do so, or lose their ssh.
_ROUTER_S, _END_S = 60.0, 10.0
_LOOK_S = 0.2
_SSH_FAILED = 255
_HELP = "write `kill NODE` or `restart NODE`; Ctrl-C ends the network"


class NetworkOverSsh:
    """Starts the commands of a plan, shows what they say, and ends them."""

    def __init__(self, plan: NetworkPlan, say: Callable[[str], None]) -> None:
        self._plan, self._say = plan, say
        self._selector = selectors.DefaultSelector()
        self._running: dict[str, Remote] = {}
        # ssh lets few sessions of one host in at a time, so each waits for the one before it.
        self._queues: dict[str, deque[Process]] = {host: deque() for host in plan.hosts}
        self._starting: dict[str, Remote] = {}
        self._listening: set[str] = set()
        self._restarts: dict[str, Process] = {}
        self._typed = b""
        processes = [
            plan.node(name, node) for name, host in plan.hosts.items() for node in host.nodes
        ]
        self._nodes = {process.name: process for process in processes}
        longest = max(len(f"{one.host} {one.name}") for one in processes)
        routers = (len(f"{host} router") for host in plan.hosts)
        self._width = max(longest, len(f"{plan.environment} {ENVIRONMENT}"), *routers)

    def __enter__(self) -> "NetworkOverSsh":
        return self

    def __exit__(self, *_: object) -> None:
        self._end_all()

    def start_routers(self) -> None:
        """Copy setup and keys to all hosts, and start their routers.

        Raises:
            ValueError: a host cannot be reached, or its router does not start.
        """
        for host in self._plan.hosts:
            copy_files(self._plan, host)
        # In order, since each connects to those before it.
        for host in self._plan.hosts:
            self._start(self._plan.router(host))
            until_s = time.monotonic() + _ROUTER_S
            while host not in self._listening:
                ended = self._take(_LOOK_S)
                if ended or time.monotonic() > until_s:
                    endpoint = self._plan.endpoint(host)
                    raise ValueError(
                        f"host {host}: its router does not listen at {endpoint}; its last words "
                        "are above"
                    )

    def run(self, *more: str) -> int:
        """Run the network until its environment ends, and return the exit code of that.

        `more` are words of `concord environment`; its standard output becomes that of this process.
        """
        environment = self._plan.environment_process(RESULTS, *more)
        self._queues[environment.host].append(environment)
        for process in self._nodes.values():
            self._queues[process.host].append(process)
        with suppress(OSError, ValueError):
            # Standard input may be closed, or a file, which cannot be awaited.
            self._selector.register(sys.stdin.fileno(), selectors.EVENT_READ)
        self._say(_HELP)
        code, until_s = None, float("inf")
        while time.monotonic() < until_s and not (code is not None and not self._has_nodes()):
            for host in self._queues:
                self._start_next(host)
            for remote, ended in self._take(_LOOK_S):
                if remote.process.name == ENVIRONMENT:
                    code, until_s = ended, time.monotonic() + _END_S
                elif code is None:
                    self._note_end(remote, ended)
        assert code is not None
        return code

    def _has_nodes(self) -> bool:
        return any(remote.process.name in self._nodes for remote in self._running.values())

    def _start_next(self, host: str) -> None:
        before = self._starting.get(host)
        if before is None or before.is_here or before.ssh.poll() is not None:
            self._starting.pop(host, None)
            if self._queues[host]:
                self._starting[host] = self._start(self._queues[host].popleft())

    def _start(self, process: Process) -> Remote:
        remote = Remote(self._plan, process)
        self._running[remote.title] = remote
        for stream in (remote.ssh.stdout, remote.ssh.stderr):
            assert stream is not None
            self._selector.register(stream, selectors.EVENT_READ, (remote, stream))
        return remote

    def _take(self, seconds: float) -> list[tuple[Remote, int]]:
        """Read what is there for so long at most; return commands that ended, with exit codes."""
        for key, _ in self._selector.select(seconds):
            if key.data is None:
                self._take_typed()
                continue
            remote, stream = key.data
            data = os.read(stream.fileno(), 65_536)
            if not data:
                self._selector.unregister(stream)
                stream.close()
            self._show(remote, stream, data)
        ended = [
            remote for remote in self._running.values()
            if remote.ssh.poll() is not None and _is_read(remote)
        ]  # fmt: skip
        for remote in ended:
            remote.end()
            del self._running[remote.title]
        return [(remote, remote.ssh.returncode) for remote in ended]

    def _show(self, remote: Remote, stream: IO[bytes], data: bytes) -> None:
        if stream is remote.ssh.stdout and remote.process.name == ENVIRONMENT:
            sys.stdout.write(data.decode(errors="replace"))
            sys.stdout.flush()
            return
        for line in remote.lines(data) if data else remote.rest():
            if remote.process.name == "router" and line.startswith(_LISTENS):
                self._listening.add(remote.process.host)
            self._say(f"{remote.title:<{self._width}} | {line}")

    def _take_typed(self) -> None:
        data = os.read(sys.stdin.fileno(), 4096)
        if not data:
            self._selector.unregister(sys.stdin.fileno())
        *lines, self._typed = (self._typed + data).split(b"\n")
        for line in lines:
            self._obey(line.decode(errors="replace").split())

    def _obey(self, words: list[str]) -> None:
        name = " ".join(["node", *words[1:]])
        if len(words) != 2 or words[0] not in ("kill", "restart") or name not in self._nodes:
            if words:
                numbers = f"NODE is 0 to {self._plan.nodes - 1}"
                self._say(f"{' '.join(words)!r} is no command; {_HELP}; {numbers}")
            return
        process = self._nodes[name]
        running = self._running.get(f"{process.host} {name}")
        if words[0] == "restart":
            self._restarts[name] = process
        if running is not None:
            running.kill()
        elif words[0] == "restart":
            self._queues[process.host].append(self._restarts.pop(name))
        else:
            self._say(f"{name} does not run; `restart {words[1]}` starts it")

    def _note_end(self, remote: Remote, code: int) -> None:
        name = remote.process.name
        if name in self._restarts:
            self._queues[remote.process.host].append(self._restarts.pop(name))
            return
        if code == 0:
            # The run is over for this node; its environment still makes the figures.
            return
        words = "ssh lost its host" if code == _SSH_FAILED else f"ended with exit code {code}"
        cure = f"; `restart {name.split()[1]}` starts it again" if name in self._nodes else ""
        self._say(f"{remote.title:<{self._width}} | {words}{cure}")

    def _end_all(self) -> None:
        """End all commands in order: routers last, for they carry the last words of the others."""
        for queue in self._queues.values():
            queue.clear()
        for is_router in (False, True):
            ending = [
                remote for remote in self._running.values()
                if (remote.process.name == "router") is is_router
            ]  # fmt: skip
            for remote in ending:
                remote.end()
            until_s = time.monotonic() + _END_S
            while time.monotonic() < until_s and any(r.title in self._running for r in ending):
                self._take(_LOOK_S)
        for remote in self._running.values():
            remote.ssh.kill()
            self._say(
                f"{remote.title:<{self._width}} | has not ended within {_END_S:g} s; see on its "
                "host whether it runs"
            )
            remote.ssh.wait()
        self._selector.close()


def _is_read(remote: Remote) -> bool:
    """Whether the command has said everything: both its streams are closed."""
    streams = (remote.ssh.stdout, remote.ssh.stderr)
    return all(stream is not None and stream.closed for stream in streams)


def announcement(plan: NetworkPlan) -> str:
    """Return the line that says where the results of a network will be."""
    return f"run {plan.run}; results in {plan.environment}:{remote_folder(plan)}/{RESULTS}"
