"""Conditions at which a run stops, in words: "nees > 10", "error 3 > 5 and missed", "silent 2".

A condition is a quantity, a node where the quantity has one, a comparison and a number. Without
comparison and number it holds where the quantity is above zero. "and" binds more than "or".
"""

import operator
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.dashboard.frames.conditions import oldest
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.topology.names import unknown_name

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip


class Quantity(NamedTuple):
    """A number of each step, in the units of the charts; NaN where it is unknown.

    `of_nodes` gives one value a node (N,), of which `together` makes that of the network.
    """

    meaning: str
    of_network: Callable[[StepFrame], float] | None = None
    of_nodes: Callable[[StepFrame], np.ndarray] | None = None
    together: Callable[[np.ndarray], float] = np.sum

    def value(self, frame: StepFrame, node: int | None) -> float:
        """Return the value at a node, or of the network for None."""
        if self.of_nodes is not None:
            values = self.of_nodes(frame)
            return float(self.together(values) if node is None else values[node])
        return float("nan") if self.of_network is None else float(self.of_network(frame))


class Clause(NamedTuple):
    """A comparison of one quantity with a number."""

    quantity: Quantity
    node: int | None
    compare: Callable[[float, float], bool]
    limit: float

    def holds(self, frame: StepFrame) -> bool:
        """Say whether it holds; a comparison with an unknown value does not."""
        return bool(self.compare(self.quantity.value(frame, self.node), self.limit))


class Breakpoint(NamedTuple):
    """A condition in its words; it holds where all clauses of one of its groups hold."""

    words: str
    groups: tuple[tuple[Clause, ...], ...]

    def holds(self, frame: StepFrame) -> bool:
        """Say whether the condition holds after a step."""
        return any(all(clause.holds(frame) for clause in group) for group in self.groups)


def read_breakpoint(words: str, stage: Stage) -> Breakpoint:
    """Return the condition that words mean in a network.

    Raises:
        ValueError: they mean none.
    """
    tokens = re.findall(r"<=|>=|<|>|[^\s<>]+", words.lower())
    groups = tuple(
        tuple(_clause(part, stage) for part in _split(group, "and"))
        for group in _split(tokens, "or")
    )
    return Breakpoint(" ".join(words.split()), groups)


def _split(tokens: list[str], word: str) -> list[list[str]]:
    """Return the tokens between those that are a word."""
    parts: list[list[str]] = [[]]
    for token in tokens:
        if token == word:
            parts.append([])
        else:
            parts[-1].append(token)
    return parts


def _clause(tokens: list[str], stage: Stage) -> Clause:
    name, *rest = tokens or [""]
    if name not in QUANTITIES:
        raise unknown_name("quantity", name, QUANTITIES)
    quantity, node = QUANTITIES[name], None
    if rest and rest[0] not in _COMPARISONS:
        node = _node(name, rest.pop(0), stage)
    if not rest:
        return Clause(quantity, node, operator.gt, 0.0)
    try:
        sign, number = rest
        return Clause(quantity, node, _COMPARISONS[sign], float(number))
    except (ValueError, KeyError):
        raise ValueError(
            f"{' '.join(tokens)!r}: after the quantity come <, <=, > or >= and a number, as in "
            f"'{name} > 10'"
        ) from None


def _node(quantity: str, name: str, stage: Stage) -> int:
    if QUANTITIES[quantity].of_nodes is None:
        raise ValueError(f"{quantity} {name}: {quantity} is of the whole network; leave {name} out")
    names = [one.lower() for one in stage.names]
    number = names.index(name) if name in names else int(name) if name.isdecimal() else -1
    if not 0 <= number < stage.nodes:
        raise ValueError(
            f"{quantity} {name}: there is no such node; nodes are {names[0]} to {names[-1]}"
        )
    return number


def _largest(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.max()) if len(known) else float("nan")


def _silent(frame: StepFrame) -> np.ndarray:
    senders = [one.node for cycle in frame.cycles for one in cycle.frames]
    return ~np.isin(np.arange(len(frame.alive)), senders)


def _nis(frame: StepFrame) -> np.ndarray:
    nis = frame.scores.nis
    nodes = range(len(frame.alive))
    return np.array([np.nan if nis is None else nis.of(node) for node in nodes])


QUANTITIES = {
    "rmse": Quantity("RMSE of the nodes", lambda f: f.scores.rmse),
    "nees": Quantity("mean NEES of the nodes", lambda f: f.scores.nees),
    "disagreement": Quantity("rms spread of the estimates", lambda f: f.scores.spread),
    "ratio": Quantity(
        "RMSE over that of the centralised filter",
        lambda f: f.scores.rmse / f.scores.central if f.scores.central else float("nan"),
    ),
    "missed": Quantity(
        "senders whose frame a neighbour missed", lambda f: sum(len(one.missed) for one in f.cycles)
    ),
    "rejected": Quantity(
        "frames that nodes rejected", lambda f: sum("rejected" in one.text for one in f.events)
    ),
    "payload": Quantity(
        "bytes of shares on the bus", lambda f: sum(one.payload_bytes for one in f.cycles)
    ),
    "error": Quantity(
        "error of a node, or the largest", of_nodes=lambda f: f.scores.error, together=_largest
    ),
    "nis": Quantity("NIS of a node, or the largest", of_nodes=_nis, together=_largest),
    "age": Quantity(
        "cycles since the oldest share that a node holds was sent",
        of_nodes=oldest, together=_largest,
    ),
    "silent": Quantity("nodes that sent no frame in the step", of_nodes=_silent),
    "down": Quantity("nodes that are down", of_nodes=lambda f: ~f.alive),
}  # fmt: skip
"""Quantities of a condition by name; those of nodes take the name of a node."""
