"""Changes of a network in a case of simulation testing, in an order that is possible.

Every word of `nodes/faults/vocabulary.py` is drawn, from its entry in the table; so a new word is
tested as well.
"""

from typing import Any

import numpy as np

from concord.nodes.changes import UNCHANGED, Settings
from concord.nodes.command_checks import check_command
from concord.nodes.commands import (
    Configure,
    CutLink,
    Inject,
    Kill,
    LoseFrames,
    Partition,
    Restart,
    Scripted,
    Soothe,
    in_words,
)
from concord.nodes.faults.active import Equipment
from concord.nodes.faults.vocabulary import CHANNELS, EVERY_FAULT, Number
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.bus_plan import arbiter_names, build_schedule
from concord.scenarios.equipment import equipment_of
from concord.scenarios.preparation import (
    complete_settings,
    prepare,
    scripted_settings,
    with_settings,
)
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import ALL_CHANNELS, FlexRay
from concord.scenarios.types.plants import PlacedSensors

# These words, beside the fault words, begin no fault.
OTHER_WORDS = ("restart", "heal", "set")
WORDS = (*EVERY_FAULT, *OTHER_WORDS)
# These words change no share that a receiver uses. A guardian blocks a babbling node where every
# slot has an owner, and one of two channels delivers every frame that is on both.
HARMLESS = (
    "duplicate", "reorder", "replay", "spoof", "guardian", "babble", "channel", "slow-cpu",
)  # fmt: skip

_SETTINGS: dict[str, tuple[Any, ...]] = {
    "rule": ("ci", "wac", "hcmci", "labelled", "diffusion", "ellipsoid", "zonotope"),
    "rounds": (1, 2, 3),
    "occupancy": (0.3, 0.6, 1),
    "schedule": ("full", "round-robin", "hybrid", "dynamic"),
    "arbiter": arbiter_names(),
    "hold": ("decayed", "predict", "drop", "renormalise"),
    "decay": (0.2, 0.7),
}
# Ranges of numbers whose own range is wider than a case.
_RANGES = {
    "CYCLES": (1, 5),
    "STEPS": (1, 6),
    "SIZE": (-20.0, 20.0),
    "SHARPNESS": (1.0, 100.0),
    "FACTOR": (1.0, 20.0),
}
_PROBABILITIES = (0.05, 0.9)
_HARMLESS_SWARMS = 0.25
# Part of the networks whose links or sensors change, and how often they do in a step.
_REDRAWN, _REDRAW_RATE = 0.5, 0.1


def draw_script(generator: np.random.Generator, setup: Setup, calm_step: int) -> tuple[str, ...]:
    """Lines such as "10 kill 3"; from `calm_step` on nothing is wrong, but what was set stays."""
    return _Author(generator, setup).written(calm_step)


def calm_from(script: tuple[Scripted, ...], steps: int) -> int:
    """The step from which on nothing is wrong that a script has brought: that of its last `calm`,
    `steps` where something is after it, or somebody stays out."""
    calm_step: int = steps
    out: set[int] = set()
    for step, command in script:
        match command:
            case Soothe():
                calm_step = step
            case Kill(node):
                out.add(node)
            case Restart(node):
                out.discard(node)
            case Inject() | CutLink() | LoseFrames() | Partition():
                calm_step = steps
    return steps if out else calm_step


def is_harmless(scenario: Scenario) -> bool:
    """Return whether no change of a scenario may change an estimate, but what was set."""
    script = script_of(scenario)
    faults: list[Inject] = []
    for _, command in script:
        if isinstance(command, Inject):
            faults.append(command)
        elif not isinstance(command, Configure | Soothe):
            return False
    kinds = [fault.kind for fault in faults]
    watched = all(fault.numbers[0] for fault in faults if fault.kind == "guardian")
    if "babble" in kinds:
        is_guarded = watched and "guardian" in kinds[: kinds.index("babble")]
        if not (is_guarded and _owns_every_slot(scenario)):
            return False
    channels = {fault.nodes for fault in faults if fault.kind == "channel"}
    if channels and not _is_redundant(scenario):
        return False
    return {*kinds} <= {*HARMLESS} and len(channels) < len(CHANNELS)


def _is_redundant(scenario: Scenario) -> bool:
    """Return whether every frame is on all channels of the bus."""
    return not isinstance(scenario.bus, FlexRay) or scenario.bus.channels == ALL_CHANNELS


def _owns_every_slot(scenario: Scenario) -> bool:
    """Return whether no node ever contends for a slot: a guardian then knows each sender."""
    setup = prepare(scenario)
    later = (settings for _, settings in scripted_settings(setup))
    return not any(contends(setup, settings) for settings in ({}, *later))


def contends(setup: Setup, settings: Settings) -> bool:
    """Return whether a node ever contends for a slot, with these settings."""
    changed = with_settings(setup, settings)
    return any(build_schedule(changed.scenario, changed.neighbours).dynamic_slot_table)


class _Author:
    """Writes a script, and knows how the network stands."""

    def __init__(self, generator: np.random.Generator, setup: Setup) -> None:
        self._generator, self._setup = generator, setup
        # A stream of its own leaves all other draws as they are without it.
        self._apart = generator.spawn(1)[0]
        self._links = [(s, r) for r, heard in enumerate(setup.neighbours) for s in heard]
        self._absent: list[int] = []
        self._cuts: set[tuple[int, int]] = set()
        self._settings: Settings = {}
        self._equipment = self._equipped()
        self._channel = self._one(CHANNELS)
        # One node lies, as the rules that expect liars are told.
        self._liar = int(generator.integers(setup.scenario.nodes))
        self._lines: list[str] = []

    def written(self, calm_step: int) -> tuple[str, ...]:
        """Return the whole script."""
        harmless = self._generator.random() < _HARMLESS_SWARMS
        words = (*HARMLESS, "set") if harmless else WORDS
        kinds = [word for word in words if self._generator.random() < (0.5 if harmless else 0.3)]
        rates = {kind: self._generator.uniform(0.02, 0.5) for kind in kinds}
        # A network that is changed all the time would not be seen at work with what it has.
        if "set" in rates:
            rates["set"] /= 4
        if harmless:
            rates.pop("guardian", None)
            self._say(1, "guardian 1")
            if contends(self._setup, self._settings):
                # No guardian knows the owner of a slot that nodes contend for.
                rates.pop("babble", None)
            if not _is_redundant(self._setup.scenario):
                rates.pop("channel", None)
        redrawn = self._apart.random() < _REDRAWN
        for step in range(1, calm_step):
            if redrawn and self._apart.random() < _REDRAW_RATE:
                self._redraw(step)
            for kind, rate in rates.items():
                if self._generator.random() < rate:
                    self._write(step, kind, harmless)
        self._calm(calm_step)
        return tuple(self._lines)

    def _write(self, step: int, kind: str, harmless: bool) -> None:
        match kind:
            case "kill":
                self._kill(step)
            case "restart":
                self._restart(step)
            case "cut":
                self._cut(step)
            case "heal":
                self._heal(step)
            case "partition":
                self._partition(step)
            case "set":
                self._set(step)
            case _:
                if not harmless:
                    self._channel = self._one(CHANNELS)
                self._fault(step, kind)

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

    def _partition(self, step: int) -> None:
        nodes = self._generator.permutation(self._setup.scenario.nodes)
        side = sorted(nodes[: 1 + int(self._generator.integers(len(nodes) - 1))].tolist())
        self._say(step, f"partition {' '.join(map(str, side))}")

    def _fault(self, step: int, word: str) -> None:
        """A fault of the table, unless this network cannot have it."""
        fault = EVERY_FAULT[word]
        numbers = [f"{self._number(number):g}" for number in fault.numbers]
        nodes = self._generator.permutation(self._setup.scenario.nodes).tolist()
        link = [*map(str, self._one(self._links)), "one-way"]
        named = {
            "link": [*numbers, *link[: 3 * (self._generator.random() < 0.5)]],
            "node": [str(self._liar if word == "lie" else nodes[0]), *numbers],
            "two nodes": [str(nodes[0]), str(nodes[1]), *numbers],
            "channel": [self._channel, *numbers],
            "bus": numbers,
        }
        said = [word, *named[fault.place]]
        try:
            check_command(in_words(said), self._setup.neighbours, UNCHANGED, False, self._equipment)
        except ValueError:
            return
        self._say(step, " ".join(said))

    def _number(self, number: Number) -> float:
        least, most = _RANGES.get(number.name, (number.least, number.most))
        if number.name == "P":
            least, most = _PROBABILITIES
        drawn = self._generator.uniform(least, most + number.is_whole)
        return int(drawn) if number.is_whole else round(float(drawn), 2)

    def _redraw(self, step: int) -> None:
        """Add a link to the graph, or move a sensor; all links of the beginning stay."""
        nodes = self._setup.scenario.nodes
        node, other = self._apart.choice(nodes, size=2, replace=False).tolist()
        x, y = self._apart.integers(0, 1000, size=2).tolist()
        links = dict.fromkeys([*self._links, (node, other), (other, node)])
        scenario = self._setup.scenario
        can_move = (
            isinstance(scenario.plant, PlacedSensors) and scenario.network.graph != "geometric"
        )
        if can_move and self._apart.random() < 0.5:
            self._configure(step, "placement", f"{node}@{x}/{y}")
        elif len(links) > len(self._links):
            self._configure(step, "graph", "edges:" + ";".join(f"{s}>{r}" for s, r in links))

    def _set(self, step: int) -> None:
        name = self._one(list(_SETTINGS))
        self._configure(step, name, self._one(_SETTINGS[name]))

    def _configure(self, step: int, name: str, value: Any) -> None:
        try:
            settings = complete_settings(self._setup, self._settings, {name: value})
        except ValueError:
            # Not every value goes with every network.
            return
        self._settings = settings
        self._equipment = self._equipped()
        self._say(step, f"set {name}={value}")

    def _equipped(self) -> Equipment:
        changed = with_settings(self._setup, self._settings)
        return equipment_of(changed, build_bus(changed))

    def _calm(self, step: int) -> None:
        """All is well again, as far as the scenario's own links are."""
        while self._absent:
            self._restart(step)
        self._say(step, "calm")
