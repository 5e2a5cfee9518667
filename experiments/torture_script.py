"""What becomes of a network in a case of torture: changes that can follow upon one another."""

from collections.abc import Callable
from typing import Any

import numpy as np

from nodes.changes import Settings
from scenarios.setup import Setup, complete_settings

SENSOR_FAULTS = ("outlier", "bias", "stuck", "dropout")
SCRIPT_FAULTS = ("kill", "restart", "cut", "heal", "loss", "partition", *SENSOR_FAULTS, "set")
# After these a reading says what its sensor never promised.
LYING_SENSORS = ("outlier", "bias", "stuck")

_SETTINGS: dict[str, tuple[Any, ...]] = {
    "rule": ("ci", "wac", "hcmci", "labelled", "diffusion", "ellipsoid", "zonotope"),
    "rounds": (1, 2, 3),
    "occupancy": (0.3, 0.6, 1),
    "schedule": ("full", "round-robin", "hybrid", "dynamic"),
    "arbiter": ("wtod", "minislot", "round-robin"),
    "hold": ("decayed", "predict", "drop", "renormalise"),
    "decay": (0.2, 0.7),
}


def draw_script(generator: np.random.Generator, setup: Setup, calm_step: int) -> tuple[str, ...]:
    """Lines such as "10 kill 3"; from `calm_step` on nothing is wrong, but what was set stays."""
    return _Author(generator, setup).written(calm_step)


class _Author:
    """Writes a script, and knows how the network stands."""

    def __init__(self, generator: np.random.Generator, setup: Setup) -> None:
        self._generator, self._setup = generator, setup
        self._links = [(s, r) for r, heard in enumerate(setup.neighbours) for s in heard]
        self._absent: list[int] = []
        self._cuts: set[tuple[int, int]] = set()
        self._settings: Settings = {}
        self._lines: list[str] = []
        self._write: dict[str, Callable[[int], None]] = {
            "kill": self._kill,
            "restart": self._restart,
            "cut": self._cut,
            "heal": self._heal,
            "loss": self._loss,
            "partition": self._partition,
            "outlier": lambda step: self._sensor(step, "outlier", self._part(), self._size()),
            "bias": lambda step: self._sensor(step, "bias", self._size()),
            "stuck": lambda step: self._sensor(step, "stuck", self._one((1, 3, 6))),
            "dropout": lambda step: self._sensor(step, "dropout", self._part()),
            "set": self._set,
        }

    def written(self, calm_step: int) -> tuple[str, ...]:
        """The whole script."""
        kinds = [kind for kind in SCRIPT_FAULTS if self._generator.random() < 0.5]
        rates = {kind: self._generator.uniform(0.02, 0.6) for kind in kinds}
        # A network that is changed all the time would not be seen at work with what it has.
        if "set" in rates:
            rates["set"] /= 4
        for step in range(1, calm_step):
            for kind, rate in rates.items():
                if self._generator.random() < rate:
                    self._write[kind](step)
        self._calm(calm_step)
        return tuple(self._lines)

    def _say(self, step: int, words: str) -> None:
        self._lines.append(f"{step} {words}")

    def _one(self, values: Any) -> Any:
        return values[int(self._generator.integers(len(values)))]

    def _kill(self, step: int) -> None:
        there = [i for i in range(self._setup.scenario.nodes) if i not in self._absent]
        if len(there) > 1:
            node = self._one(there)
            self._absent.append(node)
            self._say(step, f"kill {node}")

    def _restart(self, step: int) -> None:
        able = [i for i in self._absent if {*self._setup.neighbours[i]} - {*self._absent}]
        if able:
            node = self._one(able)
            self._absent.remove(node)
            self._say(step, f"restart {node}")

    def _cut(self, step: int) -> None:
        sender, receiver = self._one(self._links)
        one_way = self._generator.random() < 0.5
        self._cuts |= {(sender, receiver)} if one_way else {(sender, receiver), (receiver, sender)}
        self._say(step, f"cut {sender} {receiver}{' one-way' * one_way}")

    def _heal(self, step: int) -> None:
        if self._cuts:
            sender, receiver = self._one(sorted(self._cuts))
            self._cuts.discard((sender, receiver))
            self._say(step, f"heal {sender} {receiver} one-way")

    def _loss(self, step: int) -> None:
        links = "" if self._generator.random() < 0.5 else " {} {} one-way"
        self._say(step, f"loss {self._part()}" + links.format(*self._one(self._links)))

    def _partition(self, step: int) -> None:
        nodes = self._generator.permutation(self._setup.scenario.nodes)
        side = sorted(nodes[: 1 + int(self._generator.integers(len(nodes) - 1))].tolist())
        self._say(step, f"partition {' '.join(map(str, side))}")

    def _sensor(self, step: int, kind: str, *numbers: float) -> None:
        """Something is wrong with one node's sensor until all is calm."""
        node = int(self._generator.integers(self._setup.scenario.nodes))
        self._say(step, f"{kind} {node} {' '.join(map(str, numbers))}")

    def _part(self) -> float:
        return round(float(self._generator.uniform(0.05, 0.9)), 2)

    def _size(self) -> float:
        return round(float(self._generator.uniform(-20, 20)), 1)

    def _set(self, step: int) -> None:
        name = self._one(list(_SETTINGS))
        value = self._one(_SETTINGS[name])
        try:
            settings = complete_settings(self._setup, {**self._settings, name: value})
        except ValueError:
            # Not every value goes with every network.
            return
        self._settings = settings
        self._say(step, f"set {name}={value}")

    def _calm(self, step: int) -> None:
        """All is well again, as far as the scenario's own links are."""
        while self._absent:
            self._restart(step)
        self._say(step, "calm")
