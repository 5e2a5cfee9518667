"""The two ways to pace the environment process: by its nodes (lockstep), or by the clock."""

import dataclasses
import threading
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import NamedTuple, Protocol, TypeVar

from concord.nodes.changes import Gone, Welcome
from concord.nodes.command_checks import check_timely
from concord.nodes.commands import Command, Pause, Speed
from concord.nodes.environment_state import EnvironmentConfig, EnvironmentState
from concord.nodes.messages import EnvironmentMessage, Start, StepClosed, encode, topic
from concord.nodes.run_controller import RunController
from concord.nodes.tempo import Tempo
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.environment.notices import Notice
from concord.runtime.processes.environment.reports import waits_for
from concord.runtime.processes.environment.timetable import Beat, timetable
from concord.runtime.processes.republisher import Republisher

Word = TypeVar("Word")


def tell_on_time(
    start_s: float, timetable: Iterable[tuple[float, Word]], tell: Callable[[Word], None]
) -> None:
    """Call `tell(word)` in a thread of its own for each (seconds after `start_s` of the monotonic
    clock, word), which ascend; one that comes late takes nothing from the next."""

    def run() -> None:
        for after_s, word in timetable:
            time.sleep(max(0.0, start_s + after_s - time.monotonic()))
            tell(word)

    threading.Thread(target=run, daemon=True).start()


class Metronome:
    """Calls `beat()` in a thread of its own, so many times a second; never twice to catch up."""

    def __init__(self, beat: Callable[[], None]) -> None:
        self._beat = beat
        self._changed = threading.Condition()
        self._period_s: float | None = None
        self._thread: threading.Thread | None = None

    def set(self, beats_per_second: float) -> None:
        """Another rate; 0 is silence."""
        with self._changed:
            self._period_s = 1 / beats_per_second if beats_per_second else None
            self._changed.notify()
        if self._thread is None and beats_per_second:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._period_s is not None)
                period = self._period_s
                assert period is not None
                due = max(due + period, time.monotonic())
                # A change of the rate ends the wait and counts as a beat.
                self._changed.wait(due - time.monotonic())
                silenced = self._period_s is None
            if not silenced:
                self._beat()


# From the announcement of the common start to the start: every node must have heard it.
_HEAD_START_S = 0.2


class Lines(NamedTuple):
    """The ways out of the environment process; `notify` gives its own loop a notice."""

    transport: Transport
    republisher: Republisher
    notify: Callable[[Notice], None]


class EnvironmentPacing(Protocol):
    """When steps begin and end, and which messages may be lost."""

    @property
    def timed(self) -> bool:
        """Whether changes hold from the step that begins next, whatever is under way."""
        ...

    @property
    def start_s(self) -> float | None:
        """When step 0 begins on this process's monotonic clock; None where no clock decides."""
        ...

    def configured(self, config: EnvironmentConfig) -> EnvironmentConfig:
        """The configuration of an environment that is paced so."""
        ...

    def begin(self, controller: RunController, lines: Lines) -> list[EnvironmentMessage]:
        """Begin the first step, or announce when it begins."""
        ...

    def close(self) -> None:
        """The last step is over."""
        ...

    def send(self, message: EnvironmentMessage, lines: Lines) -> None:
        """Publish a message of the environment."""
        ...

    def check(self, command: Command) -> None:
        """Refuse a command that cannot be obeyed at this pace.

        Raises:
            ValueError: it cannot.
        """
        ...

    def follow(self, steps_per_second: float) -> None:
        """Keep to the rate that a command has set; 0 is as fast as possible."""
        ...

    def remind(self, absent: Collection[int], lines: Lines) -> None:
        """Tell nodes that are back and were given up; called at each beat."""
        ...

    def repeated(self, absent: Sequence[int]) -> list[tuple[str, bytes]]:
        """Messages (topic, bytes) that hold now and are repeated while nothing goes on."""
        ...

    def without_nodes(self, released: int) -> StepClosed | None:
        """The event that follows when no node is left on any host."""
        ...

    def waits_for(self, config: EnvironmentConfig, state: EnvironmentState) -> str:
        """The processes that a step waits for, in words; empty for none."""
        ...


class Lockstep:
    """A step begins when all nodes have estimated the steps before, and no message may be lost."""

    timed = False
    start_s = None

    def __init__(self, begins_paused: bool = False) -> None:
        self._begins_paused = begins_paused
        self._beats: Callable[[float], None] = lambda steps_per_second: None

    def configured(self, config: EnvironmentConfig) -> EnvironmentConfig:
        """The same."""
        return config

    def begin(self, controller: RunController, lines: Lines) -> list[EnvironmentMessage]:
        """Begin the first step, or wait for the command to begin it."""
        self._beats = Metronome(lambda: lines.notify(Beat())).set
        return controller.command(Pause()) if self._begins_paused else controller.begin()

    def close(self) -> None:
        """End the beats of a limited speed."""
        self._beats(0)

    def send(self, message: EnvironmentMessage, lines: Lines) -> None:
        """Publish, and keep the message for a repetition."""
        lines.republisher.say(topic(message), encode(message))

    def check(self, command: Command) -> None:
        """Every command can be obeyed."""

    def follow(self, steps_per_second: float) -> None:
        """Have a step released at each beat."""
        self._beats(steps_per_second)

    def remind(self, absent: Collection[int], lines: Lines) -> None:
        """A node that is back hears it when its liveliness token appears."""

    def repeated(self, absent: Sequence[int]) -> list[tuple[str, bytes]]:
        """The ends of nodes: a node that was told of a return after the end would wait for it."""
        return [("gone", encode(Gone(node))) for node in absent]

    def without_nodes(self, released: int) -> StepClosed | None:
        """The open step ends with what has come, and the environment stands still."""
        return StepClosed(released - 1)

    def waits_for(self, config: EnvironmentConfig, state: EnvironmentState) -> str:
        """The recorder, or the nodes whose estimates are missing."""
        return waits_for(config, state, timed=False)


class RealTime:
    """A step begins at its time, and what a slow link cannot take is lost."""

    timed = True

    def __init__(self, tempo: Tempo) -> None:
        self.start_s: float | None = None
        self._tempo = tempo

    def configured(self, config: EnvironmentConfig) -> EnvironmentConfig:
        """With a lead over the estimates that never ends."""
        return dataclasses.replace(config, lead=config.steps)

    def begin(self, controller: RunController, lines: Lines) -> list[EnvironmentMessage]:
        """Announce the common start; from then on a step begins at each beat."""
        start = Start(time.monotonic() + _HEAD_START_S)
        self.start_s = start.at_s
        tell_on_time(start.at_s, timetable(self._tempo, controller.config), lines.notify)
        lines.transport.send(topic(start), encode(start))
        return controller.command(Speed(1 / self._tempo.step_s))

    def close(self) -> None:
        """The timetable ends by itself."""

    def send(self, message: EnvironmentMessage, lines: Lines) -> None:
        """Offer it: a link that stands still must not hold up the clock. A welcome waits."""
        waits = isinstance(message, Welcome)
        publish = lines.transport.send if waits else lines.transport.offer
        publish(topic(message), encode(message))

    def check(self, command: Command) -> None:
        """Refuse a command that needs a step that all nodes have ended."""
        check_timely(command)

    def follow(self, steps_per_second: float) -> None:
        """The timetable gives the rate."""

    def remind(self, absent: Collection[int], lines: Lines) -> None:
        """Tell each node that is there and was given up."""
        names = [str(node) for node in absent]
        for node in set(names) - set(lines.transport.missing(names)):
            lines.transport.offer(f"gone/{node}", encode(Gone(int(node))))

    def repeated(self, absent: Sequence[int]) -> list[tuple[str, bytes]]:
        """Nothing: no node waits."""
        return []

    def without_nodes(self, released: int) -> StepClosed | None:
        """The timetable closes the step."""
        return None

    def waits_for(self, config: EnvironmentConfig, state: EnvironmentState) -> str:
        """The recorder after the last step, and no process before."""
        return waits_for(config, state, timed=True)
