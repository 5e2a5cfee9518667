"""The environment process: a loop that gives messages and notices to the run controller."""

import math
import os
import sys
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec

from concord.nodes import environment
from concord.nodes.bounds import node_of
from concord.nodes.changes import Event, Gone, Settings
from concord.nodes.commands import Answer, Kill, Restart, Scripted, read_command
from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.messages import (
    BidsClosed,
    MalformedMessage,
    StepClosed,
    decode,
    encode,
)
from concord.runtime.network.links import RECORDER, ZenohEndpoints
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.environment.decisions import (
    Action,
    AwaitReturn,
    EnvironmentDecisions,
    KillNode,
    LookAgain,
    Refuse,
    Remind,
    StartNode,
    Tell,
    TellOut,
)
from concord.runtime.processes.environment.gathering import gather
from concord.runtime.processes.environment.inbox import ENVIRONMENT_QUEUE, TOPICS, EnvironmentInbox
from concord.runtime.processes.environment.notices import (
    Alone,
    Asked,
    Notice,
    Presence,
    StillOut,
)
from concord.runtime.processes.environment.pacing import EnvironmentPacing, Lines
from concord.runtime.processes.environment.reports import (
    clock,
    last_words,
    membership_in_words,
    standing,
)
from concord.runtime.processes.job import NodeEnded
from concord.runtime.processes.peer_timeout import PeerTimeout
from concord.runtime.processes.republisher import Republisher

# A process on this machine that cannot be met in such a time has no files left, or no socket.
_MEETING_S = 60.0


class Management(NamedTuple):
    """`kill(node)` and `start(node, life)` its process, `check(before, asked)` what people want to
    set, `on_step(completed)`; `setup` is JSON to be shown. Where it `keeps_nodes` it can kill and
    start them; others' processes are on other hosts. `NodeEnded` is read from the descriptor
    `ends`."""

    kill: Callable[[int], None]
    start: Callable[[int, int], None]
    check: Callable[[Settings, Settings], Settings]
    on_step: Callable[[int], None]
    setup: bytes
    ends: int
    keeps_nodes: bool = True


def follow_ends(descriptor: int, notify: Callable[[NodeEnded], None]) -> None:
    """Notify of each end that is written to the pipe, in a thread of its own."""
    reports = os.fdopen(os.dup(descriptor), "rb")

    def read() -> None:
        with reports:
            for line in reports:
                notify(msgspec.json.decode(line, type=NodeEnded))

    threading.Thread(target=read, daemon=True).start()


# A run without a recorder ends after so long; on several hosts its link may come back any time.
_PEER_TIMEOUT_S = 60.0
# The republisher keeps the messages of some steps more than one process may be behind another.
_KEPT = 16_384
_NOT_OURS = "nodes run on hosts of their own; end and start `concord node` there"


def run_environment(
    run: str,
    links: ZenohEndpoints,
    config: EnvironmentConfig,
    fingerprint: str,
    management: Management,
    pacing: EnvironmentPacing,
    script: Sequence[Scripted] = (),
) -> None:
    """Wait for all nodes, then run to the last step; `on_step(0)` means ready.

    Raises:
        LinkError: the network cannot be joined.
        Disagreement: a node's configuration is another.
        Deserted: no node is left, and none has returned.
    """
    EnvironmentProcess(run, links, config, fingerprint, management, pacing, script).work()


class EnvironmentProcess:
    """The loop around the environment of one run."""

    def __init__(
        self,
        run: str,
        links: ZenohEndpoints,
        config: EnvironmentConfig,
        fingerprint: str,
        management: Management,
        pacing: EnvironmentPacing,
        script: Sequence[Scripted],
    ) -> None:
        self._run, self._nodes, self._fingerprint = run, config.nodes, fingerprint
        self._management, self._pacing = management, pacing
        self._told_lines = set[str]()
        self._decisions = EnvironmentDecisions(
            config, fingerprint, pacing, script, management.check, management.keeps_nodes
        )
        self.controller = self._decisions.controller
        seconds = _PEER_TIMEOUT_S if management.keeps_nodes else math.inf
        self._recorder_timeout = PeerTimeout(RECORDER, seconds)
        self.transport = Transport(run, links, TOPICS, ENVIRONMENT_QUEUE, answers=True)
        self.inbox = EnvironmentInbox(self.transport, config.nodes)
        self.republisher = Republisher(
            self.transport, "the environment", "truth", _KEPT, self._waits_for, self._repeated
        )
        self._lines = Lines(self.transport, self.republisher, self.inbox.notify)
        self.transport.answer("state", self._state)
        self.transport.answer("clock", lambda _: clock(self._pacing.start_s))
        self.transport.answer("control", self.inbox.ask)

    def work(self) -> None:
        """Run from the first hello to the end."""
        known = (self._nodes, self._fingerprint)
        # On another host a process may be started at any time.
        peer_timeout_s = _MEETING_S if self._management.keeps_nodes else math.inf
        gather(self.transport, self.inbox, *known, self._hear_of_presence, peer_timeout_s)
        self.republisher.begin()
        self.inbox.begin()
        follow_ends(self._management.ends, self.inbox.notify)
        self._management.on_step(0)
        self._act(self._decisions.done(self._pacing.begin(self.controller, self._lines)))
        while not self.controller.finished:
            before = self.controller.state.completed
            self._go_on()
            if self.controller.state.completed > before:
                self._management.on_step(self.controller.state.completed)
        self.inbox.finished = True
        self._pacing.close()
        self.republisher.say("finished", last_words(self.controller.config, self.controller.state))
        self.republisher.finish()
        self.inbox.await_end()
        self.republisher.close()
        self.transport.close()

    def _go_on(self) -> None:
        """Take the next messages of nodes, or the next notice."""
        bids = environment.awaits_bids(self.controller.config, self.controller.state)
        came = self.inbox.receive("bid/*" if bids else "estimate/*")
        if isinstance(came, list):
            for message in came:
                self._take_message(*message)
        else:
            self.attend(came)

    def _take_message(self, name: str, data: bytes) -> None:
        try:
            event = decode(name, data)
        except MalformedMessage as error:
            self.inbox.refuse(str(error))
            return
        before = self.controller.state
        self._act(self._decisions.take(event))
        if self.controller.state is before:
            # Unknown sender, closed step, or no contest.
            self.inbox.refused.add()

    def attend(self, notice: Notice) -> None:
        """Act on a notice."""
        match notice:
            case Asked(payload, answer):
                answer.put(self._obey(payload))
            case Alone():
                missing = self.transport.missing([str(node) for node in range(self._nodes)])
                self._decisions.end_if_deserted([int(name) for name in missing])
            case StillOut(node):
                if not self.transport.missing([str(node)]):
                    self._act(self._decisions.attend(Presence(node, True)))
            case BidsClosed() | StepClosed():
                self._close(notice)
            case _:
                self._act(self._decisions.attend(notice))

    def _close(self, notice: BidsClosed | StepClosed) -> None:
        # A message that is there already has come in time, however late the loop looks.
        source = "bid/*" if isinstance(notice, BidsClosed) else "estimate/*"
        for message in self.inbox.waiting(source):
            self._take_message(*message)
        self._act(self._decisions.take(notice))

    def _obey(self, payload: bytes) -> Answer:
        try:
            command = read_command(payload)
            self._pacing.check(command)
            if isinstance(command, Kill | Restart) and not self._management.keeps_nodes:
                return Answer(False, _NOT_OURS)
            self._act(self._decisions.command(command))
        except ValueError as refused:
            return Answer(False, str(refused))
        self._pacing.follow(self.controller.steps_per_second)
        return Answer(True)

    def _act(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case StartNode(node, life):
                    self._management.start(node, life)
                case KillNode(node):
                    self._management.kill(node)
                case TellOut(node):
                    self.transport.send(f"gone/{node}", encode(Gone(node)))
                case Remind(nodes):
                    self._pacing.remind(nodes, self._lines)
                case LookAgain(node, seconds):
                    self._notify_later(seconds, StillOut(node))
                case AwaitReturn(seconds):
                    self._notify_later(seconds, Alone())
                case Refuse(why):
                    self.inbox.refuse(why)
                case Tell(line):
                    self._say_once(line)
                case _:
                    if isinstance(action, Event) and (line := membership_in_words(action)):
                        sys.stderr.write(f"environment: {line}\n")
                    self._pacing.send(action, self._lines)

    def _notify_later(self, seconds: float, notice: Notice) -> None:
        timer = threading.Timer(seconds, self.inbox.notify, (notice,))
        timer.daemon = True
        timer.start()

    def _say_once(self, line: str) -> None:
        # A flood of such lines would hide all others.
        if line not in self._told_lines:
            self._told_lines.add(line)
            sys.stderr.write(f"environment: {line}\n")

    # --- on zenoh's threads, and on that of the republisher ---------------------------------------

    def _hear_of_presence(self, name: str, is_there: bool) -> None:
        self.republisher.see(name, is_there)
        self._recorder_timeout.see(name, is_there)
        node = node_of(name, self._nodes)
        if node is not None:
            self.inbox.notify(Presence(node, is_there))

    def _waits_for(self) -> str:
        return self._pacing.waits_for(self.controller.config, self.controller.state)

    def _repeated(self) -> list[tuple[str, bytes]]:
        return self._pacing.repeated(self.controller.state.standing.absent)

    def _state(self, _payload: bytes) -> bytes:
        setup, refused = self._management.setup, self.inbox.refused.number
        return standing(self._run, setup, self.controller, begun=self.inbox.begun, refused=refused)
