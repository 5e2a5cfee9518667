"""Golden transcripts: what a fault does to a small network, and how its machines go through a step.

A transcript of a fault tells of every step: the changes that begin with it, the frames that were
sent, and each node's estimate with the counters that grew. A transcript of a phase tells of every
event that a machine took in this phase, with the next phase and the messages sent.
"""

from collections import Counter
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from concord.bus.flexray.share_frames import read_frame
from concord.nodes import environment, node, node_changes
from concord.nodes.changes import Change, Event, Fault, Welcome
from concord.nodes.environment_state import EnvironmentPhase
from concord.nodes.messages import (
    Bid,
    Estimate,
    Grant,
    ShareHeard,
    ShareSent,
    Truth,
    decode,
    from_wire,
)
from concord.nodes.node_state import Phase
from concord.scenarios.setup import Setup
from tests.nodes.changing import messages


class _Step:
    """The messages of one step."""

    def __init__(self) -> None:
        self.truth: Truth | None = None
        self.changes: list[str] = []
        self.frames: list[tuple[str, int]] = []
        self.estimates: dict[int, Estimate] = {}


def of_fault(setup: Setup, *changes: str) -> list[str]:
    """Return the transcript of a run with one communication cycle a step."""
    steps = [_Step() for _ in range(setup.scenario.steps)]
    for topic, data in messages(setup, *changes):
        if topic.startswith("share/"):
            cycle, sender = read_frame(data).cycle, topic.partition("/")[2]
            steps[cycle].frames.append((sender, len(data)))
            continue
        match decode(topic, data):
            case Truth() as truth:
                steps[truth.step].truth = truth
            case Estimate() as estimate:
                steps[estimate.step].estimates[estimate.node] = estimate
            case Event(step=step, change=change) if isinstance(step, int):
                steps[step].changes.append(in_words(change))
            case Welcome(node=index, step=step):
                steps[step].changes.append(f"node {index} is let in again")
    lines: list[str] = []
    before: dict[int, Counter[str]] = {}
    for number, step in enumerate(steps):
        lines += ["", f"STEP {number}", *(f"  change  {change}" for change in step.changes)]
        sizes = " or ".join(str(size) for size in sorted({size for _, size in step.frames}))
        senders = ", ".join(sorted(sender for sender, _ in step.frames))
        lines.append(f"  frames  from {senders}, of {sizes} bytes")
        lines += _estimates(setup, step, before)
    return lines


def _estimates(setup: Setup, step: _Step, before: dict[int, Counter[str]]) -> Iterator[str]:
    assert step.truth is not None
    truth = from_wire(step.truth.state)
    for index, neighbours in enumerate(setup.neighbours):
        estimate = step.estimates.get(index)
        if estimate is None:
            before.pop(index, None)
            yield f"  node {index}  is out"
            continue
        error = np.linalg.norm(from_wire(estimate.mean) - truth)
        ages = zip(neighbours, estimate.ages, strict=True)
        held = ", ".join(f"{sender} {_age(age)}" for sender, age in ages)
        counters = Counter(estimate.counters)
        grown = counters - before.get(index, Counter())
        before[index] = counters
        counts = ", ".join(f"{name} {count}" for name, count in sorted(grown.items()))
        yield f"  node {index}  error {error:.2f}; holds {held}; counts {counts or 'nothing'}"


def _age(age: int) -> str:
    return "never" if age < 0 else "new" if age == 0 else f"{age} old"


def in_words(change: Change) -> str:
    """Return a change as a line of text: its name and what it names."""
    if isinstance(change, Fault):
        ended = not any(change.numbers[:1])
        numbers = "ends" if ended else f"with {_plain(change.numbers)}"
        return f"{change.kind} of {_plain(change.nodes)} {numbers}"
    fields = msgspec.to_builtins(change)
    what = fields.pop("what")
    told = (f"{name} {_plain(value)}" for name, value in fields.items())
    return " ".join([what, *told])


def _plain(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "all"
    return f"{value:g}" if isinstance(value, float) else str(value)


def of_phases(
    setup: Setup, monkeypatch: pytest.MonkeyPatch, *changes: str
) -> dict[Phase | EnvironmentPhase, list[str]]:
    """Return the transcript of each phase: node 1 for those of a node, and the environment."""
    told: dict[Phase | EnvironmentPhase, list[str]] = {
        phase: [] for phase in (*Phase, *EnvironmentPhase)
    }
    node_step, apply, world_step = node.step, node_changes.apply, environment.step

    def tell_node(config, state, *events):
        after, messages = node_step(config, state, *events)
        if config.index == 1:
            for event in events:
                told[state.phase].append(_line(event, after.phase, messages))
        return after, messages

    def tell_change(config, state):
        config, after, messages = apply(config, state)
        if config.index == 1:
            told[Phase.CHANGE].append(_line("the change", after.phase, messages))
        return config, after, messages

    def tell_environment(config, state, event):
        before = environment.phase_of(config, state)
        after, messages = world_step(config, state, event)
        told[before].append(_line(event, environment.phase_of(config, after), messages))
        return after, messages

    monkeypatch.setattr(node, "step", tell_node)
    monkeypatch.setattr(node_changes, "apply", tell_change)
    monkeypatch.setattr(environment, "step", tell_environment)
    messages(setup, *changes)
    return told


def _line(event: object, phase: Phase | EnvironmentPhase, messages: list) -> str:
    sent = ", ".join(_event(message) for message in messages)
    if len(messages) > 3:
        kinds = Counter(type(message).__name__.lower() for message in messages)
        sent = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    return f"  {_event(event):<40} -> {phase.value:<12} {f'sends {sent}' if sent else ''}".rstrip()


def _event(event: object) -> str:
    match event:
        case str():
            return event
        case ShareHeard(sender=sender, frame=frame):
            return f"share of {sender}, cycle {read_frame(frame).cycle}"
        case ShareSent(node=sender, frame=frame):
            return f"share of {sender}, cycle {read_frame(frame).cycle}"
        case Bid(node=sender, cycle=cycle, bid=bid):
            return f"bid {bid} of {sender}, cycle {cycle}"
        case Grant(cycle=cycle, winners=winners):
            return f"grant to {_plain(winners)}, cycle {cycle}"
        case Event(step=step, change=change):
            return f"event of step {step}: {in_words(change)}"
    fields = msgspec.to_builtins(event) if isinstance(event, msgspec.Struct) else {}
    named = (f"{name} {fields[name]}" for name in ("node", "step", "limit") if name in fields)
    return " ".join([type(event).__name__.lower(), *named])
