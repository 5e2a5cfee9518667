"""The environment process: a loop that gives messages and notices to the run controller."""

import math
from collections.abc import Sequence

from concord.nodes import environment
from concord.nodes.bounds import node_of
from concord.nodes.changes import Gone
from concord.nodes.commands import Answer, Kill, Restart, read_command
from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.messages import (
    BidsClosed,
    EnvironmentEvent,
    EnvironmentMessage,
    MalformedMessage,
    StepClosed,
    Unreachable,
    decode,
    encode,
)
from concord.nodes.run_controller import ProcessStarter, RunController, Scripted
from concord.runtime.network.links import RECORDER, ZenohEndpoints
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.environment.desertion import Desertion
from concord.runtime.processes.environment.gathering import gather
from concord.runtime.processes.environment.inbox import ENVIRONMENT_QUEUE, TOPICS, EnvironmentInbox
from concord.runtime.processes.environment.management import Management
from concord.runtime.processes.environment.node_lives import NodeLives, follow_ends
from concord.runtime.processes.environment.notices import (
    Alone,
    Asked,
    Hello,
    Notice,
    Presence,
    RecorderCaughtUp,
    Repeated,
)
from concord.runtime.processes.environment.pacing import EnvironmentPacing, Lines
from concord.runtime.processes.environment.reports import clock, last_words, standing
from concord.runtime.processes.environment.timetable import Beat
from concord.runtime.processes.job import NodeEnded
from concord.runtime.processes.peer_timeout import PeerTimeout
from concord.runtime.processes.republisher import Republisher

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
        # Nodes that leave on command, until the recorder has kept what they said; then nodes whose
        # processes are being killed.
        self._leaving, self._dying = set[int](), set[int]()
        self._lives = NodeLives(config.nodes, management.start)
        stage = ProcessStarter(self._leaving.add, self._start_node, management.check)
        config = pacing.configured(config)
        self.controller = RunController(config, script, stage, pacing.timed)
        seconds = _PEER_TIMEOUT_S if management.keeps_nodes else math.inf
        self._recorder_timeout = PeerTimeout(RECORDER, seconds)
        self.transport = Transport(run, links, TOPICS, ENVIRONMENT_QUEUE, answers=True)
        self.inbox = EnvironmentInbox(self.transport, config.nodes)
        self.republisher = Republisher(
            self.transport, "the world", "truth", _KEPT, self._waits_for, self._repeated
        )
        self._desertion = Desertion(self.transport, self.inbox.notify, config.nodes)
        self._lines = Lines(self.transport, self.republisher, self.inbox.notify)
        self.transport.answer("state", self._state)
        self.transport.answer("clock", lambda _: clock(self._pacing.start_s))
        self.transport.answer("control", self.inbox.ask)

    def work(self) -> None:
        """Run from the first hello to the end."""
        known = (self._nodes, self._fingerprint)
        gather(self.transport, self.inbox, *known, self._hear_of_presence)
        self.republisher.begin()
        self.inbox.begin()
        follow_ends(self._management.ends, self.inbox.notify)
        self._management.on_step(0)
        self._send(self._pacing.begin(self.controller, self._lines))
        while not self.controller.finished:
            before = self.controller.state.completed
            self._go_on()
            if self.controller.state.completed > before:
                self._management.on_step(self.controller.state.completed)
        self.inbox.finished = True
        self._pacing.close()
        self.republisher.say("finished", last_words(self.controller.config, self.controller.state))
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
        self._take(event)
        if self.controller.state is before:
            # Unknown sender, closed step, or no contest.
            self.inbox.refused.add()

    def _take(self, event: EnvironmentEvent) -> None:
        self._send(self.controller.take(event))

    def attend(self, notice: Notice) -> None:
        """Act on a notice."""
        match notice:
            case Repeated(event):
                # An event that has come before changes nothing, and is no mistake.
                self._take(event)
            case Presence(node, is_there):
                self._see(node, is_there)
            case Hello():
                self._let_in(notice)
            case RecorderCaughtUp(node):
                self._end(node)
            case NodeEnded(node, life) if life == self._lives.newest[node]:
                self._send(self.controller.not_started(node))
            case Asked(payload, answer):
                answer.put(self._obey(payload))
            case Alone():
                self._desertion.end(self.controller.deserted)
            case Beat():
                self._send(self.controller.tick())
                self._pacing.remind(self.controller.state.standing.absent, self._lines)
            case BidsClosed() | StepClosed():
                self._close(notice)
            case Unreachable(node, neighbour):
                # Frames between the two are lost: one is out until there is a link again.
                absent = self.controller.state.standing.absent
                if node not in absent and neighbour not in absent:
                    self._give_up(neighbour)

    def _close(self, notice: BidsClosed | StepClosed) -> None:
        # A message that is there already has come in time, however late the loop looks.
        source = "bid/*" if isinstance(notice, BidsClosed) else "estimate/*"
        for message in self.inbox.waiting(source):
            self._take_message(*message)
        self._take(notice)

    def _see(self, node: int, is_there: bool) -> None:
        if not is_there:
            self._dying.discard(node)
            self.controller.lost(node)
            self._give_up(node)
        elif node in self.controller.state.standing.absent:
            # A node that was given up may have been out of reach only: it must know.
            self.transport.send(f"gone/{node}", encode(Gone(node)))

    def _let_in(self, hello: Hello) -> None:
        if hello.fingerprint != self._fingerprint:
            self.inbox.refuse(f"node {hello.node} comes with another setup; refused")
            return
        if hello.node in self._leaving | self._dying:
            # A node that is told of its own end asks to be let in until its process is killed.
            return
        if hello.node not in self.controller.state.standing.absent:
            # It was started again before its end was seen.
            self._take(Gone(hello.node))
        self._send(self.controller.ready(hello.node))

    def _end(self, node: int) -> None:
        if node in self._leaving:
            self._leaving.discard(node)
            self._dying.add(node)
            self._management.kill(node)
        else:
            self.inbox.refuse(f"node {node} was not to leave")

    def _give_up(self, node: int) -> None:
        self._take(Gone(node))
        if not self.controller.deserted:
            return
        # This process may be the one that was cut off, or stood still: it waits for the nodes.
        closed = self._pacing.without_nodes(self.controller.state.released)
        if closed is not None:
            self._take(closed)
        if self._management.keeps_nodes:
            self._desertion.begin()

    def _obey(self, payload: bytes) -> Answer:
        try:
            command = read_command(payload)
            self._pacing.check(command)
            if isinstance(command, Kill | Restart) and not self._management.keeps_nodes:
                return Answer(False, _NOT_OURS)
            self._send(self.controller.command(command))
        except ValueError as refused:
            return Answer(False, str(refused))
        self._pacing.follow(self.controller.steps_per_second)
        return Answer(True)

    def _start_node(self, node: int) -> bool:
        self._leaving.discard(node)
        self._dying.discard(node)
        self._lives.start(node)
        return False

    def _send(self, messages: Sequence[EnvironmentMessage]) -> None:
        for message in messages:
            self._pacing.send(message, self._lines)

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
