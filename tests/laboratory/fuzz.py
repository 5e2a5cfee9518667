"""Malformed frames and messages against a network that runs.

An intruder without keys joins every process of a lockstep network. On each topic that the process
subscribes to, the intruder sends messages that no sound process sends. Some process must refuse and
count each of them. The estimates must be those of an undisturbed network, bit for bit. Well-formed
messages with untrue content are not tested: without keys no process can detect them
(docs/security.md).
"""

import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import tyro

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.nodes.commands import Speed
from concord.nodes.messages import Estimate, decode
from concord.runtime.drivers import in_memory
from concord.runtime.network.links import ENVIRONMENT, RECORDER, names
from concord.runtime.recorded import meaning, message_of
from tests.laboratory.intruder import Intruder, intruders
from tests.laboratory.malformed import malformed
from tests.laboratory.running import Running, memory_mb, neighbouring_ports, oscillators

NODES, STEPS, RATE = 4, 3000, 10.0
RUN = "fuzz"
REFUSED = ("rejected", "late", "repeated")
# So often a command is asked for that cannot be obeyed.
QUESTIONS, ASK_EVERY = "questions", 1000


@dataclass(frozen=True)
class FuzzOptions:
    """How many, and which."""

    messages: int = 1_000_000
    """Malformed messages, over all processes."""
    seed: int = 1
    """Which."""


class Outcome(msgspec.Struct):
    """Counts of the messages: sent to each process, refused by each, and refused by reason."""

    sent: dict[str, int]
    refused: dict[str, int]
    reasons: dict[str, int]
    same_estimates: bool
    seconds: float
    memory_mb: tuple[dict[str, int], dict[str, int]]


def storm(everybody: list[Intruder], messages: int, seed: int) -> tuple[Counter, Counter]:
    """Say it all; returns how many were sent to whom, and how many questions were refused."""
    rng = np.random.default_rng(seed)
    (environment,) = (one for one in everybody if one.name == ENVIRONMENT)
    sent: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    for number in range(messages):
        if number % ASK_EVERY == 0:
            sent[QUESTIONS] += 1
            refused[QUESTIONS] += environment.command(number // ASK_EVERY)
            continue
        one = everybody[number % len(everybody)]
        turn = number // len(everybody)
        topic, whole, ways = one.said[turn % len(one.said)]
        way = turn // len(one.said)
        one.transport.send(topic, malformed(way, ways, whole[way % len(whole)], rng))
        sent[one.name] += 1
        if number % 50_000 == 49_999:
            sys.stderr.write(f"{number + 1} messages\n")
    return sent, refused


def believed(messages: list[tuple[str, bytes]], nodes: int) -> tuple[dict, dict[str, Counter[str]]]:
    """Return the estimates of the nodes by (node, step), and the last counters of each node."""
    estimates, counters = {}, {}
    for topic, data in messages:
        if message_of(topic, data, nodes) is None or not topic.startswith("estimate/"):
            continue
        estimate: Estimate = decode(topic, data)
        told = (estimate.mean, estimate.cov, estimate.ages)
        estimates[estimate.node, estimate.step] = told
        counters[str(estimate.node)] = Counter(estimate.counters)
    return estimates, counters


def storm_of(messages: int, seed: int, steps: int = STEPS) -> Outcome:
    """A network of four in lockstep in such a storm."""
    setup = oscillators(NODES, "ring", steps)
    sound = in_memory(setup)
    cast = names(setup.neighbours)
    ports = neighbouring_ports(cast)
    with tempfile.TemporaryDirectory() as folder:
        running = Running(setup, RUN, Path(folder), ports[cast[0]])
        client, pids = running.client, running.pids
        client.command(Speed(RATE))
        while client.state()["completed"] < 10:
            time.sleep(0.02)
        everybody = intruders(RUN, setup.neighbours, ports, sound)
        for one in everybody:
            one.pose()
        before, began_s = memory_mb(pids), time.monotonic()
        sent, refused = storm(everybody, messages, seed)
        # The last messages are still on their way; wait until the environment has refused its own.
        while client.state()["refused"] < sent[ENVIRONMENT] and time.monotonic() - began_s < 600:
            time.sleep(0.05)
        client.command(Speed(RATE))
        now = client.state()["completed"]
        while client.state()["completed"] < min(now + 20, steps - 1):
            time.sleep(0.05)
        seconds, after = time.monotonic() - began_s, memory_mb(pids)
        refused[ENVIRONMENT] = client.state()["refused"]
        for one in everybody:
            one.transport.close()
        running.end()
        recorded = running.recorded()
    refused[RECORDER] = sum(
        meaning(topic, data, NODES, SHARE_FRAMES) is None for topic, data in recorded
    )
    alone, quiet = believed(sound, NODES)
    stormed, counters = believed(recorded, NODES)
    reasons: Counter[str] = Counter()
    for node, told in counters.items():
        more = {
            name: number - quiet[node].get(name, 0)
            for name, number in told.items()
            if name.startswith(REFUSED)
        }
        refused[node] = sum(more.values())
        reasons.update(more)
    return Outcome(
        dict(sent), dict(refused), dict(reasons), alone == stormed, seconds, (before, after)
    )


def fuzz(options: Annotated[FuzzOptions, tyro.conf.arg(name="")]) -> None:
    """Send malformed messages to every process of a network; each is refused, no estimate moves."""
    outcome = storm_of(options.messages, options.seed)
    total, refused = sum(outcome.sent.values()), sum(outcome.refused.values())
    lines = [f"{total} messages sent, {refused} refused and counted, in {outcome.seconds:.0f} s"]
    for name, number in outcome.sent.items():
        lines.append(f"  {name}: {number} sent, {outcome.refused[name]} refused")
    lines += [f"  nodes, {name}: {number}" for name, number in sorted(outcome.reasons.items())]
    before, after = outcome.memory_mb
    lines.append(f"  MB before {before}, after {after}")
    same = "those" if outcome.same_estimates else "NOT those"
    lines.append(f"  the estimates are {same} of a network left alone, bit for bit")
    sys.stdout.write("\n".join(lines) + "\n")
    sys.exit(0 if outcome.same_estimates and outcome.sent == outcome.refused else 1)
