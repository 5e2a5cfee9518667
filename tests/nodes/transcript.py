"""A run told as a story: one line for everything that happens, in the order in which it happens."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from bus.flexray.share_frames import read_frame
from filters.gaussian import Gaussian
from nodes.estimator import AnyEstimator
from nodes.messages import Bid, Estimate, Grant, Measured, Truth, decode, from_wire
from nodes.node import NodeConfig
from nodes.rules.belief_consensus import BeliefConsensus
from runtime import in_process
from tests.nodes.networks import Network

Fate = set[tuple[int, int, int]]


class Storyteller:
    """Writes down what it is told; also the recorder and the link of a run."""

    def __init__(self, rounds: int, lost: Fate) -> None:
        self.lines: list[str] = []
        self._rounds, self._lost = rounds, lost

    def tell(self, when: str, who: str, what: str) -> None:
        self.lines.append(f"  {when:<8} {who:<7} {what}")

    def record(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Tell the sent messages from the sender's view."""
        for topic, data in messages:
            self._retell(topic, data)

    def _retell(self, topic: str, data: bytes) -> None:
        if topic.startswith("share/"):
            fragment = read_frame(data)
            what = f"sends its belief: {len(data)} bytes in slot {fragment.frame_id}"
            self.tell(f"cycle {fragment.cycle}", f"node {topic.partition('/')[2]}", what)
            return
        match decode(topic, data):
            case Truth(step=step, state=state):
                self.lines += ["", f"STEP {step}"]
                self.tell("", "plant", f"is at {_number(state[0])}")
            case Measured(node=node, readings=[[value]]) if value is not None:
                self.tell("", "world", f"lets node {node} read {_number(value)}")
            case Bid(node=node, cycle=cycle, bid=bid):
                self.tell(f"cycle {cycle}", f"node {node}", f"asks for a slot with {bid}")
            case Grant(cycle=cycle, winners=winners):
                self.tell(f"cycle {cycle}", "world", f"grants slots to {_names(winners)}")
            case Estimate() as said:
                counts = ", ".join(f"{name} {count}" for name, count in said.counters.items())
                belief = Gaussian(from_wire(said.mean), from_wire(said.cov)[None])
                self.tell("", f"node {said.node}", f"estimates {_belief(belief)}; so far {counts}")

    def close(self) -> None:
        self.lines.append("")

    def link(self, sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        """Tell whether a frame arrives, and return it if it does."""
        cycle = read_frame(frame).cycle
        lost = (sender, receiver, cycle) in self._lost
        arrow = "LOST on its way to" if lost else "on its way to"
        self.tell("", "", f"  {arrow} node {receiver}")
        return () if lost else (frame,)


class Telling:
    """An estimator that tells what it does, and otherwise does what another does."""

    def __init__(self, inner: AnyEstimator, node: NodeConfig, story: Storyteller) -> None:
        self._inner, self._node, self._story = inner, node, story
        self._cycle = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def begin_step(self, content: Any, measured: Measured) -> tuple[Any, tuple[str, ...]]:
        after, failures = self._inner.begin_step(content, measured)
        before, now = self._inner.belief(content), self._inner.belief(after)
        what = "takes its reading" if measured.readings != [[None]] else "reads nothing"
        if measured.step > 0:
            what = f"predicts, {what}"
        told = [_belief(before), _belief(now)]
        self._story.tell("", self._name, f"{what}: {' becomes '.join(dict.fromkeys(told))}")
        return after, failures

    def fuse(self, content: Any, shares: tuple[Any, ...]) -> tuple[Any, tuple[str, ...]]:
        after, failures = self._inner.fuse(content, shares)
        ages: np.ndarray = self._inner.ages(after)
        pairs = zip(self._node.neighbours, shares, strict=True)
        fresh = [j for j, share in pairs if share is not None]
        stale = [(j, age) for j, age in zip(self._node.neighbours, ages, strict=True) if age > 0]
        sources = [f"what it heard from {_names(fresh)}"] if fresh else []
        sources += [f"what it holds of {j} (age {age})" for j, age in stale]
        what = f"fuses {' and '.join(sources) or 'nothing'}: {_belief(self._inner.belief(after))}"
        due = self._node.schedule.static_senders(self._cycle)
        missing = [j for j in self._node.neighbours if j in due and j not in fresh]
        if missing:
            vain = f"has waited in vain for {_names(missing)}: the time of the cycle is over"
            self._story.tell(f"cycle {self._cycle}", self._name, vain)
        self._story.tell(f"cycle {self._cycle}", self._name, what)
        self._cycle += 1
        return after, failures

    @property
    def _name(self) -> str:
        return f"node {self._node.index}"


def tell(net: Network, lost: Fate) -> list[str]:
    """The lines of a run in which these shares (sender, receiver, cycle) are lost."""
    story = Storyteller(net.world.rounds, lost)
    told = [
        replace(node, estimator=cast(BeliefConsensus, Telling(node.estimator, node, story)))
        for node in net.nodes
    ]
    in_process.run(net.world, told, story, link=story.link)
    return story.lines


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:+.2f}"


def _belief(belief: Gaussian) -> str:
    return f"{_number(belief.mean[0])} ± {np.sqrt(belief.cov.ravel()[0]):.2f}"


def _names(nodes: Iterable[int]) -> str:
    return " and ".join(map(str, nodes)) or "nobody"
