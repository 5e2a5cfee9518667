"""The launcher process under a virtual clock: starts, ends and stops of processes, and leases."""

from collections import deque
from collections.abc import Callable
from functools import partial

from concord.runtime.processes.environment.notices import Notice, Presence
from concord.runtime.processes.job import NodeEnded
from tests.laboratory.lives.case import Boot, Incident
from tests.laboratory.lives.processes import NodeProcess
from tests.laboratory.lives.virtual_clock import VirtualClock

LEASE_S = 2.0
_SEEN_S, _TOLD_S, _BACK_S = (0.01, 0.05), (0.01, 0.1), (0.05, 1.5)


class Launcher:
    """Newest process of each node; `seen` are the nodes whose tokens the environment sees."""

    def __init__(
        self,
        clock: VirtualClock,
        nodes: int,
        boots: tuple[Boot, ...],
        make: Callable[[int, int], NodeProcess],
        between: Callable[[tuple[float, float]], float],
        notify: Callable[[Notice], None],
    ) -> None:
        self._clock, self._boots, self._make = clock, deque(boots), make
        self._between, self._notify = between, notify
        self.newest = [make(node, 0) for node in range(nodes)]
        self.seen = set(range(nodes))
        for process in self.newest:
            process.is_ready = True

    def missing(self) -> list[int]:
        """Return the nodes whose tokens the environment process does not see."""
        return [node for node in range(len(self.newest)) if node not in self.seen]

    def start(self, node: int, life: int) -> None:
        """Start a process, which may die before it is ready."""
        self.kill(self.newest[node])
        process = self.newest[node] = self._make(node, life)
        boot = self._boots.popleft()
        end = self.kill if boot.dies else self._ready
        self._clock.after(boot.seconds, partial(end, process))

    def kill(self, process: NodeProcess) -> None:
        """End a process at once; others see it later."""
        if process.is_dead:
            return
        process.is_dead = True
        if process.is_ready:
            self._clock.after(self._between(_SEEN_S), partial(self._lose, process))
        self._clock.after(self._between(_TOLD_S), partial(self._report, process))

    def befall(self, incident: Incident) -> None:
        """Kill or stop a process."""
        process = self.newest[incident.node]
        if incident.name == "kill":
            self.kill(process)
        elif process.is_ready and not process.is_dead:
            process.is_stopped = True
            self._clock.after(LEASE_S, partial(self._lose_if_stopped, process))
            self._clock.after(incident.seconds, partial(self._resume, process))

    def lose_links(self) -> None:
        """The environment process, which stood still beyond the lease, has lost all links."""
        for process in self.newest:
            if process.node in self.seen:
                self._lose(process)
                self._clock.after(self._between(_BACK_S), partial(self._see, process))

    def _ready(self, process: NodeProcess) -> None:
        if not process.is_dead:
            process.is_ready = True
            self._see(process)
            process.enter()

    def _see(self, process: NodeProcess) -> None:
        """The environment process sees the token of a process again."""
        if process.is_stopped:
            self._clock.after(self._between(_BACK_S), partial(self._see, process))
        elif self.newest[process.node] is process and not process.is_dead:
            self.seen.add(process.node)
            self._notify(Presence(process.node, True))

    def _lose(self, process: NodeProcess) -> None:
        """The environment process sees that a token is gone."""
        newest = self.newest[process.node]
        is_followed = newest is not process and newest.is_ready
        if process.node in self.seen and not is_followed:
            self.seen.discard(process.node)
            self._notify(Presence(process.node, False))

    def _lose_if_stopped(self, process: NodeProcess) -> None:
        if process.is_stopped:
            self._lose(process)

    def _resume(self, process: NodeProcess) -> None:
        if process.node not in self.seen:
            self._clock.after(self._between(_BACK_S), partial(self._see, process))
        process.resume()

    def _report(self, process: NodeProcess) -> None:
        """Tell the environment process of an end, unless the next process is there."""
        if self.newest[process.node] is process:
            self._notify(NodeEnded(process.node, process.life))
