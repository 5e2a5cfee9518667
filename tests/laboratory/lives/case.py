"""A case: a network, the ends and stops of its processes, and how long each start takes."""

from typing import Literal

import msgspec
import numpy as np

from concord.nodes.tempo import Tempo
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup

_STEPS = 52
# Nothing happens in the last part of a run, so that all is well at its end.
_CALM_PART = 0.6
_STEP_S, _CYCLE_S = 0.25, 0.05
_RUN_S = _STEPS * _STEP_S
_FORGED_PART = 0.3
IncidentName = Literal["kill", "restart", "stop", "stop environment", "forge"]


class Incident(msgspec.Struct, frozen=True):
    """A signal to a process, or a command: SIGKILL, `restart`, or SIGSTOP for so long.

    A forged message tells `node` that the node `other` is gone.
    """

    at_s: float
    name: IncidentName
    node: int = 0
    seconds: float = 0.0
    other: int = 0


class Boot(msgspec.Struct, frozen=True):
    """The start of a process: how long it takes, and whether the process ends before it is over."""

    seconds: float
    dies: bool


class LivesCase(msgspec.Struct, frozen=True):
    """Equal cases give equal runs.

    `tempo` is None in lockstep. `boots` of the processes that are started, in order.
    """

    seed: int
    nodes: int
    graph: str
    changes: tuple[str, ...]
    tempo: Tempo | None
    incidents: tuple[Incident, ...]
    boots: tuple[Boot, ...]

    def setup(self) -> Setup:
        """Return the network."""
        wanted = {"nodes": self.nodes, "graph": self.graph, "rounds": 1, "steps": _STEPS}
        scenario = definition_named("oscillator").defaults
        return prepare(scenario.with_(**wanted, seed=self.seed, changes=self.changes))

    @property
    def ends_within_s(self) -> float:
        """The virtual time at which the run has to be over."""
        stops_s = sum(one.seconds for one in self.incidents if one.name == "stop environment")
        return 6 * _RUN_S + stops_s


def draw_lives(seed: int) -> LivesCase:
    """Draw a case: in three of five the network keeps real time."""
    generator = np.random.default_rng([seed, 26])
    nodes = int(generator.integers(3, 6))
    is_timed = generator.random() < 0.6
    boots = [
        Boot(float(generator.uniform(0.1, 1.5)), bool(generator.random() < 1 / 3))
        for _ in range(40)
    ]
    return LivesCase(
        seed,
        nodes,
        str(generator.choice(["ring", "complete", "path"])),
        _script(generator, nodes, is_timed),
        Tempo(1.0, _CYCLE_S, _STEP_S) if is_timed else None,
        tuple(
            sorted([*_incidents(generator, nodes), *_forged(seed, nodes)], key=lambda one: one.at_s)
        ),
        tuple(boots),
    )


def _script(generator: np.random.Generator, nodes: int, is_timed: bool) -> tuple[str, ...]:
    """Return deaths and returns by command, and slow processors that recover."""
    lines = []
    last = int(_STEPS * (1 - _CALM_PART))
    if generator.random() < 0.5:
        node, step = int(generator.integers(nodes)), int(generator.integers(2, last - 6))
        again = step + int(generator.integers(1, 6))
        lines += [f"{step} kill {node}", f"{again} restart {node}"]
    if is_timed and generator.random() < 0.4:
        node, step = int(generator.integers(nodes)), int(generator.integers(1, last - 8))
        factor = round(float(generator.uniform(50, 1500)))
        lines += [f"{step} slow-cpu {node} {factor}", f"{last} slow-cpu {node} 0"]
    return tuple(sorted(lines, key=lambda line: int(line.split()[0])))


def _incidents(generator: np.random.Generator, nodes: int) -> tuple[Incident, ...]:
    found = []
    last_s = _RUN_S * (1 - _CALM_PART)
    for _ in range(int(generator.integers(0, 4))):
        node, at_s = int(generator.integers(nodes)), float(generator.uniform(0.3, last_s))
        if generator.random() < 0.6:
            found.append(Incident(at_s, "kill", node))
            for _ in range(int(generator.integers(0, 3))):
                at_s = float(generator.uniform(at_s, last_s))
                found.append(Incident(at_s, "restart", node))
        else:
            found.append(Incident(at_s, "stop", node, float(generator.uniform(0.1, 4.0))))
    if generator.random() < 0.2:
        at_s, seconds = float(generator.uniform(0.3, last_s)), float(generator.uniform(0.2, 4.0))
        found.append(Incident(at_s, "stop environment", 0, seconds))
    return tuple(found)


def _forged(seed: int, nodes: int) -> tuple[Incident, ...]:
    # A stream of its own leaves the other draws of a seed as they were.
    generator = np.random.default_rng([seed, 28])
    if generator.random() >= _FORGED_PART:
        return ()
    at_s = float(generator.uniform(0.3, _RUN_S * (1 - _CALM_PART)))
    node, other = generator.integers(nodes, size=2).tolist()
    return (Incident(at_s, "forge", node, other=other),)
