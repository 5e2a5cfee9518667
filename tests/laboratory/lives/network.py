"""A network of processes under a virtual clock: environment, launcher, links and leases."""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.nodes.changes import Event, Gone, Left, Welcome
from concord.nodes.commands import Restart, Speed
from concord.nodes.messages import (
    EnvironmentMessage,
    Estimate,
    Grant,
    Measured,
    NodeMessage,
    ShareSent,
    StepClosed,
    encode,
    topic,
)
from concord.runtime.processes.environment.decisions import (
    Action,
    AwaitReturn,
    Deserted,
    EnvironmentDecisions,
    KillNode,
    LookAgain,
    Remind,
    StartNode,
    TellOut,
)
from concord.runtime.processes.environment.notices import (
    Alone,
    Hello,
    Notice,
    Presence,
    RecorderCaughtUp,
    StillOut,
)
from concord.runtime.processes.environment.pacing import Lockstep, RealTime
from concord.runtime.processes.environment.timetable import timetable
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import complete_settings
from concord.scenarios.script import script_of
from tests.laboratory.broken import Broken
from tests.laboratory.lives.case import Incident, LivesCase
from tests.laboratory.lives.launcher import LEASE_S, Launcher
from tests.laboratory.lives.processes import (
    LockstepProcess,
    NodeProcess,
    RealTimeProcess,
)
from tests.laboratory.lives.promises import RAISED, Watch
from tests.laboratory.lives.virtual_clock import Repetition, VirtualClock

START_S = 1.0
# Messages on a link, in lockstep slower, so that a run lasts longer than its incidents.
_DELAYS_S, _LOCKSTEP_DELAYS_S = (2e-4, 4e-3), (0.1, 0.5)
_RECORDED_S = (0.01, 0.3)
_LOST = 0.5
_DIGEST = "a" * 64


class LivesNetwork:
    """Runs a case: every process is a state machine, and this is all that is between them."""

    def __init__(self, case: LivesCase) -> None:
        self.case, self.setup = case, case.setup()
        self.clock = VirtualClock()
        self._generator = np.random.default_rng([case.seed, 27])
        self._losses = np.random.default_rng([case.seed, 28])
        config = build_environment(self.setup)
        self._pacing = Lockstep() if case.tempo is None else RealTime(case.tempo)
        self.decisions = EnvironmentDecisions(
            config,
            _DIGEST,
            self._pacing,
            script_of(self.setup.scenario),
            partial(complete_settings, self.setup),
            keeps_nodes=True,
        )
        self.watch = Watch(case, self.decisions.controller, START_S)
        self._audience = [
            [i for i in range(case.nodes) if node in self.setup.neighbours[i]]
            for node in range(case.nodes)
        ]
        self.launcher = Launcher(
            self.clock, case.nodes, case.boots, self._process, self._between, self._notify
        )
        self._notices, self._messages = deque[Notice](), deque[Estimate]()
        self._arrived_s: dict[tuple[int, int], float] = {}
        self._stopped = False
        self._repetition = Repetition(self.clock, self._repeat)

    # --- the run ----------------------------------------------------------------------------------

    def run(self) -> None:
        """Run to the end, or to the first broken promise.

        Raises:
            Broken: a promise is broken.
            Deserted: the environment process ends the run.
        """
        for incident in self.case.incidents:
            self.clock.at(START_S + incident.at_s, partial(self._befall, incident))
        self.clock.at(START_S, self._begin)
        self.clock.run(
            START_S + self.case.ends_within_s, lambda: self.decisions.controller.finished
        )
        self.watch.check_end(self.launcher.newest)

    def _begin(self) -> None:
        controller, tempo = self.decisions.controller, self.case.tempo
        if tempo is None:
            self._act(self.decisions.done(controller.begin()))
            self._repetition.begin()
            return
        self._act(self.decisions.done(controller.command(Speed(1 / tempo.step_s))))
        for after_s, word in timetable(tempo, controller.config):
            self.clock.at(START_S + after_s, partial(self._notify, word))
        for process in self.launcher.newest:
            process.wake()

    def _process(self, node: int, life: int) -> NodeProcess:
        config, tempo = build_node(self.setup, node), self.case.tempo
        if tempo is None:
            return LockstepProcess(self.clock, self, config, life)
        return RealTimeProcess(self.clock, self, config, life, tempo, START_S)

    def _between(self, bounds: tuple[float, float]) -> float:
        return float(self._generator.uniform(*bounds))

    # --- the environment process ------------------------------------------------------------------

    def _notify(self, notice: Notice) -> None:
        self._notices.append(notice)
        self._go_on()

    def _go_on(self) -> None:
        """Attend to notices first and then to messages, as the process's loop does."""
        while not self._stopped and (self._notices or self._messages):
            if not self._notices:
                self._act(self.decisions.take(self._messages.popleft()))
                continue
            notice = self._notices.popleft()
            if isinstance(notice, Alone):
                newest, missing = self.launcher.newest, self.launcher.missing()
                self.watch.check_deserted(newest, missing, self.decisions)
            elif isinstance(notice, StillOut):
                if notice.node in self.launcher.seen:
                    self._act(self.decisions.attend(Presence(notice.node, True)))
            elif isinstance(notice, StepClosed):
                while self._messages:
                    self._act(self.decisions.take(self._messages.popleft()))
                self._act(self.decisions.take(notice))
            else:
                self._act(self.decisions.attend(notice))

    def _act(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case StartNode(node, life):
                    self.launcher.start(node, life)
                case KillNode(node):
                    self.launcher.kill(self.launcher.newest[node])
                case TellOut(node):
                    # A word on a link that has just come back may be lost.
                    if self._losses.random() < _LOST:
                        continue
                    self._deliver(node, f"gone/{node}", encode(Gone(node)))
                case LookAgain(node, seconds):
                    self.clock.after(seconds, partial(self._notify, StillOut(node)))
                case Remind(nodes) if self.case.tempo is not None:
                    for node in sorted(set(nodes) & self.launcher.seen):
                        self._deliver(node, f"gone/{node}", encode(Gone(node)))
                case AwaitReturn(seconds):
                    self.clock.after(seconds, partial(self._notify, Alone()))
                case Measured() | Welcome() | Grant() | Gone() | Event():
                    self._send(action)

    def _repeat(self) -> None:
        absent = self.decisions.controller.state.standing.absent
        for name, data in () if self._stopped else self._pacing.repeated(absent):
            for node in range(self.case.nodes):
                self._deliver(node, name, data)

    def _send(self, message: EnvironmentMessage) -> None:
        self._repetition.note()
        match message:
            case Measured(node) | Welcome(node):
                if isinstance(message, Welcome):
                    self.watch.hear_welcome(message)
                self._deliver(node, topic(message), encode(message))
            case Grant() | Gone():
                for node in range(self.case.nodes):
                    self._deliver(node, topic(message), encode(message))
            case Event(_, Left(node)):
                caught_up = partial(self._notify, RecorderCaughtUp(node))
                self.clock.after(self._between(_RECORDED_S), caught_up)

    # --- links ------------------------------------------------------------------------------------

    def _delay_s(self) -> float:
        return self._between(_DELAYS_S if self.case.tempo else _LOCKSTEP_DELAYS_S)

    def _arrive(self, sender: int, receiver: int, call: Callable[[], None]) -> None:
        """Have a message arrive; a link keeps the order of its messages."""
        at_s = max(self.clock.now_s + self._delay_s(), self._arrived_s.get((sender, receiver), 0.0))
        self._arrived_s[sender, receiver] = at_s
        self.clock.at(at_s, call)

    def _deliver(self, node: int, name: str, data: bytes) -> None:
        """Send a message of the environment process; in real time a broken link loses it."""
        if node in self.launcher.seen or self.case.tempo is None:
            self._arrive(-1, node, lambda: self.launcher.newest[node].hear(name, data))

    def is_linked(self, node: int) -> bool:
        """Whether the links between a node and the environment process stand."""
        return node in self.launcher.seen

    def hello(self, node: int) -> None:
        """A node asks to be let in."""
        if self.is_linked(node):
            self._arrive(node, -1, partial(self._notify, Hello(node, _DIGEST)))

    def post(self, node: int, message: NodeMessage) -> None:
        """A node sends a message."""
        match message:
            case ShareSent():
                for receiver in self._audience[node]:
                    hear = partial(
                        lambda to, data: self.launcher.newest[to].hear(f"share/{node}", data),
                        receiver,
                        message.frame,
                    )
                    self._arrive(node, receiver, hear)
            case Estimate():
                self.watch.hear_estimate(message, self.clock.now_s)
                if node in self.launcher.seen or self.case.tempo is None:
                    self._arrive(node, -1, partial(self._take, message))

    def _take(self, message: Estimate) -> None:
        self._messages.append(message)
        self._go_on()

    # --- incidents --------------------------------------------------------------------------------

    def _befall(self, incident: Incident) -> None:
        match incident.name:
            case "restart":
                self._restart(incident.node)
            case "stop environment":
                self._stopped = True
                self.clock.after(incident.seconds, partial(self._resume, incident.seconds))
            case "forge":
                self.launcher.newest[incident.node].hear("gone", encode(Gone(incident.other)))
            case _:
                self.launcher.befall(incident)

    def _restart(self, node: int) -> None:
        if self._stopped:
            return
        # A user is told if the node is not out.
        with suppress(ValueError):
            self._act(self.decisions.command(Restart(node)))

    def _resume(self, seconds: float) -> None:
        """Go on; a process that stood still beyond the lease has lost all links."""
        self._stopped = False
        if seconds > LEASE_S:
            self.launcher.lose_links()
        self._go_on()


class LivesOutcome(NamedTuple):
    """Outcome of a case: the broken promise, or None, and what was seen; counts of the run."""

    seed: int
    broken: str | None
    seen: str
    estimates: int
    joins: int


def run_lives(case: LivesCase) -> LivesOutcome:
    """Run a case to its end or to the first promise that breaks."""
    network = LivesNetwork(case)
    broken, seen = None, ""
    try:
        network.run()
    except Deserted:
        # All processes are dead: the run has no other end.
        pass
    except Broken as error:
        broken, seen = error.invariant, error.seen
    except Exception as error:  # whatever a machine raises is what is looked for
        broken, seen = RAISED, f"{type(error).__name__}: {error}"
    return LivesOutcome(case.seed, broken, seen, network.watch.estimates, network.watch.joins)
