"""State of a network since its start: its nodes, its cut links, its settings.

The changes are those of docs/control.md; each holds from the step that it names.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import msgspec

from concord.dashboard.frames.frame import LogEntry
from concord.nodes.faults.vocabulary import CHANNELS, EVERY_FAULT
from concord.plants.placement import SITES
from concord.scenarios.scenario import SETTINGS


class NetworkStatus(NamedTuple):
    """The network at a step.

    Attributes:
        members: who takes part. cut: directed links (sender, receiver). losses: part of the frames
        that a link loses, `loss` that of every other. settings: what was set since the start.
        anchor: a step, the communication cycle with which it begins, and cycles per step from then
        on.
    """

    members: frozenset[int]
    anchor: tuple[int, int, int]
    cut: frozenset[tuple[int, int]] = frozenset()
    losses: Mapping[tuple[int, int], float] = {}
    loss: float = 0.0
    settings: Mapping[str, Any] = {}
    paused: bool = False

    @property
    def rounds(self) -> int:
        """Communication cycles per step."""
        return self.anchor[2]

    def cycles(self, step: int) -> range:
        """Return the communication cycles of a step."""
        since, first, rounds = self.anchor
        begin = first + (step - since) * rounds
        return range(begin, begin + rounds)


class AnnouncedChange(NamedTuple):
    """A change and the step from which it holds."""

    step: int
    what: str
    facts: Mapping[str, Any]


def read_change(data: bytes) -> AnnouncedChange | None:
    """Return the change that bytes on topic `event` tell; None for what says nothing."""
    try:
        told = msgspec.json.decode(data)
        facts = told["change"]
        return AnnouncedChange(int(told["step"]), str(facts["what"]), facts)
    except (msgspec.MsgspecError, KeyError, TypeError, ValueError):
        return None


def changed(
    network: NetworkStatus, change: AnnouncedChange, names: tuple[str, ...]
) -> tuple[NetworkStatus, LogEntry]:
    """Return the network after a change, and the line of the log that tells of it.

    Raises:
        KeyError, TypeError, ValueError, IndexError: the change is malformed.
    """
    network_after, event = _applied(network, change, names)
    return network_after, event._replace(words=_words(network, change))


def after_all(
    network: NetworkStatus, changes: Sequence[AnnouncedChange], names: tuple[str, ...]
) -> tuple[NetworkStatus, list[LogEntry]]:
    """Return the network after changes, and the lines of the log that tell of them."""
    lines = []
    for change in changes:
        # A newer network may tell of more than this page knows.
        with suppress(KeyError, TypeError, ValueError, IndexError):
            before = network
            network, line = changed(network, change, names)
            # A paused network tells of its pace again at each step that it is asked for.
            if change.what != "pace" or not (before.paused and network.paused):
                lines.append(line)
    return network, lines


def _words(network: NetworkStatus, change: AnnouncedChange) -> str:
    """Return the command behind a change, as a script says it; a link in one direction."""
    facts = change.facts
    link = f"{facts.get('sender')} {facts.get('receiver')} one-way"
    match change.what:
        case "left" | "gone":
            return f"kill {facts['node']}"
        case "joined":
            return f"restart {facts['node']}"
        case "cut" | "healed":
            return f"{'cut' if change.what == 'cut' else 'heal'} {link}"
        case "loss":
            of = "" if facts.get("sender") is None else f" {link}"
            return f"loss {float(facts['probability']):g}{of}"
        case "fault":
            return _fault_words(facts)
        case "calm":
            return "calm"
        case "settings":
            told = dict(facts["settings"]).items()
            new = [f"{k}={v}" for k, v in told if network.settings.get(k) != v]
            return f"set {' '.join(new)}" if new else ""
    return ""


def _fault_words(facts: Mapping[str, Any]) -> str:
    kind, nodes = str(facts["kind"]), [str(node) for node in facts["nodes"]]
    place = EVERY_FAULT[kind].place
    numbers = [f"{float(number):.12g}" for number in facts["numbers"]]
    if place == "link":
        return " ".join((kind, *numbers, *nodes, *(["one-way"] if nodes else [])))
    if place == "channel":
        nodes = [CHANNELS[int(node)] for node in nodes]
    return " ".join((kind, *nodes, *numbers))


def _applied(
    network: NetworkStatus, change: AnnouncedChange, names: tuple[str, ...]
) -> tuple[NetworkStatus, LogEntry]:
    facts = change.facts
    match change.what:
        case "left" | "gone" | "joined":
            return _membership(network, change, names)
        case "present":
            node, mistaken = int(facts["node"]), int(facts["mistaken"])
            text = f"node {names[mistaken]} took node {names[node]} for out, which takes part"
            return network, LogEntry(change.step, text, mistaken, True)
        case "cut" | "healed":
            link = (int(facts["sender"]), int(facts["receiver"]))
            is_cut = change.what == "cut"
            cut = network.cut | {link} if is_cut else network.cut - {link}
            text = f"link {names[link[0]]} → {names[link[1]]} {change.what}"
            return network._replace(cut=cut), LogEntry(change.step, text, link[0], is_cut)
        case "loss":
            return _loss(network, change, names)
        case "fault":
            return network, _fault(change, names)
        case "calm":
            calm = network._replace(cut=frozenset(), losses={}, loss=0.0)
            return calm, LogEntry(change.step, "all faults are withdrawn")
        case "settings":
            return _settings(network, change)
        case "pace":
            paused = bool(facts.get("paused"))
            rate = facts.get("steps_per_second") or 0
            speed = f"at most {rate:g} steps per second" if rate else "as fast as it can"
            text = "paused" if paused else f"running, {speed}"
            return network._replace(paused=paused), LogEntry(change.step, text)
    raise ValueError(change.what)


def _membership(
    network: NetworkStatus, change: AnnouncedChange, names: tuple[str, ...]
) -> tuple[NetworkStatus, LogEntry]:
    node = int(change.facts["node"])
    words = {"left": "was killed", "gone": "is gone", "joined": "is back"}
    back = change.what == "joined"
    members = network.members | {node} if back else network.members - {node}
    text = f"node {names[node]} {words[change.what]}"
    return network._replace(members=members), LogEntry(change.step, text, node, not back)


def _loss(
    network: NetworkStatus, change: AnnouncedChange, names: tuple[str, ...]
) -> tuple[NetworkStatus, LogEntry]:
    facts, chance = change.facts, float(change.facts["probability"])
    if facts.get("sender") is None:
        text = f"every link loses {100 * chance:.0f} % of its frames"
        return network._replace(loss=chance), LogEntry(change.step, text, None, chance > 0)
    link = (int(facts["sender"]), int(facts["receiver"]))
    text = f"link {names[link[0]]} → {names[link[1]]} loses {100 * chance:.0f} % of its frames"
    losses = {**network.losses, link: chance}
    return network._replace(losses=losses), LogEntry(change.step, text, link[0], chance > 0)


def _fault(change: AnnouncedChange, names: tuple[str, ...]) -> LogEntry:
    """Return the event of a fault, in the words of its request."""
    kind, facts = str(change.facts["kind"]), change.facts
    place, nodes = EVERY_FAULT[kind].place, [int(node) for node in facts["nodes"]]
    known = CHANNELS if place == "channel" else names
    numbers = [f"{float(number):g}" for number in facts["numbers"]]
    text = " ".join((kind, *(known[node] for node in nodes), *numbers))
    node = nodes[0] if nodes and place != "channel" else None
    return LogEntry(change.step, text, node, float(numbers[0]) != 0)


def _settings(network: NetworkStatus, change: AnnouncedChange) -> tuple[NetworkStatus, LogEntry]:
    told = dict(change.facts["settings"])
    settings = {**network.settings, **{k: v for k, v in told.items() if k in SETTINGS}}
    rounds = int(settings.get("rounds", network.rounds))
    since = (change.step, int(change.facts["first_cycle"]), rounds)
    text = "set " + ", ".join(f"{k} {value_in_words(k, v)}" for k, v in told.items())
    return network._replace(settings=settings, anchor=since), LogEntry(change.step, text)


def value_in_words(name: str, value: object) -> object:
    """Return the value of a setting as a person says it: of a graph the number of its links, and
    of all sites that of the sensors."""
    count = str(value).count(";") + 1
    if name == "graph":
        return f"one of {count} links"
    all_sites = name == "placement" and str(value).startswith(SITES)
    return f"sites of {count} sensors" if all_sites else value
