"""A recording computed again: a run in lockstep is a function of its setup and its events.

The changes that were recorded are given to the in-process driver, each in its step, and the
messages compared byte by byte. The death of a process is no such event: which of its last words
were heard is recorded nowhere. So a run is compared up to the first death.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from concord.bus.bus import Rejected
from concord.nodes.bounds import UNREADABLE
from concord.nodes.changes import (
    Calm,
    Change,
    Cut,
    Event,
    Fault,
    Gone,
    Healed,
    Joined,
    Left,
    Loss,
    PaceChange,
    Present,
    Set,
)
from concord.nodes.commands import (
    ChangeCommand,
    Configure,
    CutLink,
    HealLink,
    Inject,
    Kill,
    LoseFrames,
    Restart,
    Scripted,
    Soothe,
)
from concord.nodes.history import history_of, with_event
from concord.nodes.messages import Bid, Grant, MalformedMessage, decode
from concord.results.folder import read_description, recording_of
from concord.runtime.drivers import drive
from concord.runtime.recording import MemoryRecorder, read_recording
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.setup import Setup

_UNPLACED = -1
# Words on the links and processes of a machine, which a run in one process does not have.
_OF_MACHINE = ("gone", "unreachable", "timing", "start")
_Steps = dict[int, dict[str, list[bytes]]]


class Again(NamedTuple):
    """A run computed again.

    Attributes:
        messages, steps: how many were compared.
        differences: a sentence for each message, in the order of the run.
        ends: why later steps were not compared; "" where all were.
    """

    messages: int
    steps: int
    differences: tuple[str, ...]
    ends: str


class _Enough(Exception):
    """All steps that are compared have been computed."""


def computed_again(folder: Path) -> Again:
    """Compute the run of a folder again in this process, and compare each message.

    Raises:
        ValueError: the folder holds no run, one in real time, or changes that are none.
    """
    description = read_description(folder)
    if description.tempo is not None:
        raise ValueError(f"{folder}: a run in real time depends on the clock; leave --again out")
    setup = description.setup
    messages = list(read_recording(recording_of(folder)))
    events = [(one.step, one.change) for one in _events(messages)]
    last, ends = setup.scenario.steps, ""
    for step, change in events:
        if isinstance(change, Gone | Present) and step < last:
            last, ends = step, f"node {change.node} died in step {step}"
    try:
        script = [
            Scripted(step, _command(change))
            for step, change in events
            if step < last and not isinstance(change, PaceChange)
        ]
    except TypeError as error:
        raise ValueError(f"{folder}: an event is no change of a run ({error})") from None
    recorder = MemoryRecorder()

    def on_step(completed: int) -> None:
        if completed > last:
            raise _Enough

    with suppress(_Enough):
        drive(setup, recorder, on_step, script)
    computed = _by_step(setup, recorder.messages)
    recorded = _by_step(setup, messages)
    differences = [
        *_unplaced(recorded, setup.scenario.steps),
        *_differences(computed, recorded, last),
    ]
    compared = sum(len(one) for k in range(last) for one in computed.get(k, {}).values())
    return Again(compared, last, tuple(differences), ends)


def _events(messages: Iterable[tuple[str, bytes]]) -> Iterator[Event]:
    for topic, data in messages:
        if topic == "event":
            with suppress(*UNREADABLE, MalformedMessage):
                yield decode(topic, data)


def _command(change: Change) -> ChangeCommand:
    match change:
        case Left(node):
            return Kill(node)
        case Joined(node):
            return Restart(node)
        case Cut(sender, receiver):
            return CutLink(sender, receiver, both=False)
        case Healed(sender, receiver):
            return HealLink(sender, receiver, both=False)
        case Loss(probability, sender, receiver):
            return LoseFrames(probability, sender, receiver, both=False)
        case Fault(kind, nodes, numbers):
            return Inject(kind, nodes, numbers, both=False)
        case Calm():
            return Soothe()
        case Set(settings):
            return Configure(settings)
    raise TypeError(type(change).__name__)


def _by_step(setup: Setup, messages: Iterable[tuple[str, bytes]]) -> _Steps:
    """Return the messages by step and topic; those that belong to no step are of -1."""
    frames, history = frame_format(setup.scenario), history_of(setup.scenario.rounds, ())
    found: _Steps = defaultdict(lambda: defaultdict(list))
    for topic, data in messages:
        if topic.partition("/")[0] in _OF_MACHINE:
            continue
        step = _UNPLACED
        with suppress(*UNREADABLE, MalformedMessage, Rejected, StopIteration, ValueError):
            if topic.startswith("share/"):
                step = history.place(frames.read(data).cycle)[0]
            else:
                message = decode(topic, data)
                if isinstance(message, Event):
                    if isinstance(message.change, PaceChange):
                        continue
                    history = with_event(history, message)
                if isinstance(message, Bid | Grant):
                    step = history.place(message.cycle)[0]
                else:
                    step = getattr(message, "step", _UNPLACED)
        found[step][topic].append(data)
    return found


def _unplaced(recorded: _Steps, steps: int) -> Iterator[str]:
    """Yield the messages that belong to none of so many steps."""
    for topic, strange in sorted(recorded.get(_UNPLACED, {}).items()):
        yield f"{topic[:60]}: {len(strange)} messages of no step"
    for step in sorted(recorded.keys() - {_UNPLACED} - set(range(steps))):
        yield f"step {step}: the run has no such step"


def _differences(computed: _Steps, recorded: _Steps, steps: int) -> Iterator[str]:
    """Yield where the recorded messages of the first steps are not those that were computed."""
    empty = [step for step in range(steps) if step not in recorded]
    if empty:
        yield f"steps {empty[0]} to {empty[-1]}: nothing is recorded of {len(empty)} steps"
    for step in range(steps):
        ours, theirs = computed.get(step, {}), recorded.get(step, {})
        for topic in sorted({*ours, *theirs}) if theirs else ():
            place = f"step {step}, {topic}"
            yield from _of_topic(place, ours.get(topic, []), theirs.get(topic, []))


def _of_topic(place: str, ours: list[bytes], theirs: list[bytes]) -> Iterator[str]:
    if ours == theirs:
        return
    lacking, added = Counter(ours) - Counter(theirs), Counter(theirs) - Counter(ours)
    if not (lacking or added):
        yield f"{place}: in another order"
    for _ in range(min(lacking.total(), added.total())):
        yield f"{place}: another content"
    for _ in range(lacking.total() - added.total()):
        yield f"{place}: is not recorded"
    for _ in range(added.total() - lacking.total()):
        yield f"{place}: was never sent, or once less"
