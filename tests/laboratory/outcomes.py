"""Outcome of a frame at a receiver, computed from the announced faults.

Both accounts must use the same random draws, so the draws are those of `nodes/faults/active.py`.
Their consequences are computed here anew from docs/faults.md, not by `nodes/faults` and
`nodes/inbox.py`.
"""

from collections.abc import Callable
from typing import NamedTuple

from concord.bus.clocks import ClockDrift, ClockErrors
from concord.nodes.faults.active import EVERYBODY, Faults
from concord.nodes.faults.retries import Passage
from concord.nodes.faults.vocabulary import PASSING

# Faults that spoil a frame for all receivers of a bus with automatic retransmission.
_ERRORS = ("crc", "corrupt", "babble")


class Fate(NamedTuple):
    """Outcome of a frame at one receiver.

    Attributes:
        counts: counters that increase at once. later: (cycle, counter that increases at its start).
        is_usable: the share may use the frame. is_overtaken: the frame comes after all others.
        struck: the fault words that caused the outcome.
    """

    counts: tuple[str, ...]
    later: tuple[tuple[int, str], ...]
    is_usable: bool
    is_overtaken: bool
    struck: tuple[str, ...]


def fate_of(
    faults: Faults,
    way: Passage,
    frame: bytes,
    is_contended: bool,
    has_slot: Callable[[int], bool],
) -> Fate:
    """The fate of a frame that its sender meant to send, in a slot that it won if `is_contended`;
    `has_slot(node)` says who has a slot in its cycle."""
    if faults.equipment.retransmissions and not _stands_still(faults, way.step, way.receiver):
        errors = _failed_tries(faults, way, is_contended)
        if len(errors) > faults.equipment.retransmissions:
            return Fate(("rejected",), (), False, False, (errors[-1],))
        fate = fate_of(_sent_once(faults), way, frame, is_contended, has_slot)
        return fate._replace(struck=(*errors, *fate.struck))
    for word, counted in _obstacles(faults, way, is_contended):
        return Fate((counted,), (), False, False, (word,))
    reading, struck = _reading(faults, way, frame)
    later, late_words = _late(faults, way)
    again = [later]
    replay = _at(faults, "replay", way.step, way.sender)
    if replay is not None and _strikes(faults, "replay", way, way.receiver):
        struck = (*struck, "replay")
        again.append(later + int(replay[1]))
    if later:
        # Outside of its slot it is no frame of this cycle, and of an earlier one when it comes.
        counted = reading or "late"
        comes = tuple((way.cycle + cycles, counted) for cycles in again)
        return Fate((), comes, False, False, struck + late_words)
    counts = [reading] if reading else []
    if _strikes_link(faults, "duplicate", way):
        counts.append(reading or "repeated")
        struck = (*struck, "duplicate")
    victims = _victims(faults, way, has_slot)
    counts += ["rejected"] * len(victims)
    is_overtaken = _strikes_link(faults, "reorder", way)
    counts += ["reordered"] * is_overtaken
    struck += ("spoof",) * len(victims) + ("reorder",) * is_overtaken
    comes = tuple((way.cycle + cycles, reading or "late") for cycles in again[1:])
    return Fate(tuple(counts), comes, not reading, is_overtaken, struck)


def must_be_silent(faults: Faults, step: int, cycle: int, node: int) -> str:
    """Return the word that keeps a node from saying anything in its turn; "" for none."""
    if _stands_still(faults, step, node):
        return "hang"
    if (clocks := _clocks(faults, cycle)) is not None and not clocks.sends[node]:
        return "drift"
    missing = _at(faults, "missing", step, node)
    strikes = missing is not None and faults.draw("missing", cycle, node, EVERYBODY) < missing[0]
    return "missing" if strikes else ""


def _at(faults: Faults, kind: str, step: int, *nodes: int) -> tuple[float, ...] | None:
    """Return the numbers of a fault of a node, link, channel or the bus; None without a fault."""
    # A fault of one link takes precedence over a fault of all links.
    fault = faults.standing.get((kind, nodes)) or faults.standing.get((kind, ()))
    if fault is None or fault.numbers[0] == 0:
        return None
    is_over = kind in PASSING and step - fault.first_step >= fault.numbers[0]
    return None if is_over else fault.numbers


def _stands_still(faults: Faults, step: int, node: int) -> bool:
    return _at(faults, "hang", step, node) is not None


def _obstacles(faults: Faults, way: Passage, is_contended: bool) -> list[tuple[str, str]]:
    """Return the faults that keep a frame from being read, with their counters.

    The first entry decides.
    """
    found = []
    if _stands_still(faults, way.step, way.receiver):
        found.append(("hang", "lost"))
    if (clocks := _clocks(faults, way.cycle)) is not None and not clocks.hears[way.receiver]:
        found.append(("drift", "lost"))
    apart_us = abs(_ahead_us(faults, way, way.sender) - _ahead_us(faults, way, way.receiver))
    if apart_us > faults.equipment.precision_us:
        found.append(("drift", "rejected"))
    is_guarded = _at(faults, "guardian", way.step) and not is_contended
    if not is_guarded and any(
        _makes_noise(faults, way, nodes[0]) for kind, nodes in faults.standing if kind == "babble"
    ):
        found.append(("babble", "rejected"))
    # A frame on one channel alone has no other way.
    letters = [*faults.equipment.channels]
    used = [letters.index(letter) for letter in way.channels] or range(len(letters))
    fails = {place: _at(faults, "channel", way.step, place) for place in used}
    if all(
        chance is not None
        and faults.draw("channel", way.cycle, way.sender, EVERYBODY + 1 + place, way.number)
        < chance[0]
        for place, chance in fails.items()
    ):
        found.append(("channel", "lost"))
    return found


def _failed_tries(faults: Faults, way: Passage, is_contended: bool) -> list[str]:
    """Return the fault word that spoils each failed try of a frame, up to the last possible one."""
    spoilt: list[str] = []
    for retry in range(faults.equipment.retransmissions + 1):
        suffix = f" again {retry}" if retry else ""
        words = [word for word in _ERRORS if _spoils(faults, way, word, suffix, is_contended)]
        if not words:
            break
        spoilt.append(words[0])
    return spoilt


def _spoils(faults: Faults, way: Passage, word: str, suffix: str, is_contended: bool) -> bool:
    """Return whether a fault spoils a try; each try has draws of its own."""

    def strikes(node: int, receiver: int, place: tuple[int, ...], number: int) -> bool:
        chance = _at(faults, word, way.step, *place)
        draw = faults.draw(word + suffix, way.cycle, node, receiver, number)
        return chance is not None and draw < chance[0]

    if word == "crc":
        return strikes(way.sender, EVERYBODY, (way.sender,), way.number)
    if word == "corrupt":
        heard_by = enumerate(faults.equipment.neighbours)
        pairs = [(way.sender, node) for node, heard in heard_by if way.sender in heard]
        return any(strikes(*pair, pair, way.number) for pair in pairs)
    if _at(faults, "guardian", way.step) and not is_contended:
        return False
    babblers = [nodes[0] for kind, nodes in faults.standing if kind == word]
    return any(
        node != way.sender
        and not _stands_still(faults, way.step, node)
        and strikes(node, EVERYBODY, (node,), way.frame_id)
        for node in babblers
    )


def _sent_once(faults: Faults) -> Faults:
    """Return the faults of a bus that sends each frame once and spoils none."""
    standing = {place: one for place, one in faults.standing.items() if place[0] not in _ERRORS}
    once = faults.equipment._replace(retransmissions=0)
    return faults._replace(standing=standing, equipment=once)


def _ahead_us(faults: Faults, way: Passage, node: int) -> float:
    """Return the lead of a node's clock at the end of the frame's cycle."""
    if (clocks := _clocks(faults, way.cycle)) is not None:
        return clocks.ahead_us[node]
    drift = _at(faults, "drift", way.step, node)
    if drift is None:
        return 0.0
    cycles = way.cycle - faults.first_cycle("drift", node) + 1
    return cycles * faults.equipment.cycle_us * drift[0] / 1e6


def _clocks(faults: Faults, cycle: int) -> ClockErrors | None:
    """Return the synchronised clocks of a network in which some drift."""
    drifting = {nodes: fault for (word, nodes), fault in faults.standing.items() if word == "drift"}
    drifts = tuple(
        ClockDrift(node, drifting[node,].numbers[0], drifting[node,].first_cycle)
        for (node,) in sorted(drifting)
        if drifting[node,].numbers[0] != 0
    )
    keep = faults.equipment.clocks
    disturbed = drifts or faults.outages
    return (
        None if keep is None or not disturbed else keep(drifts, faults.outages, cycle, faults.key)
    )


def _makes_noise(faults: Faults, way: Passage, node: int) -> bool:
    babble = _at(faults, "babble", way.step, node)
    if babble is None or node == way.sender or _stands_still(faults, way.step, node):
        return False
    return faults.draw("babble", way.cycle, node, EVERYBODY, way.frame_id) < babble[0]


def _reading(faults: Faults, way: Passage, frame: bytes) -> tuple[str, tuple[str, ...]]:
    """Return the counter of a frame that was altered ("" if unaltered), and the fault words."""
    last_bit = 8 * (len(frame) - 1)
    crc = {last_bit} if _strikes(faults, "crc", way, EVERYBODY) else set()
    corrupt = _flipped(faults, way, len(frame))
    struck = ("crc",) * bool(crc) + ("corrupt",) * bool(corrupt)
    is_null = _strikes(faults, "null", way, EVERYBODY)
    wrong = _at(faults, "wrong-step", way.step, way.sender)
    is_old = wrong is not None and _strikes(faults, "wrong-step", way, EVERYBODY)
    struck += ("null",) * is_null + ("wrong-step",) * is_old
    # A bit that is flipped twice keeps its value.
    if is_null or crc ^ corrupt:
        return "rejected", struck
    earlier = wrong is not None and is_old and min(int(wrong[1]), way.cycle) > 0
    return ("late" if earlier else ""), struck


def _flipped(faults: Faults, way: Passage, length: int) -> set[int]:
    if not _strikes_link(faults, "corrupt", way):
        return set()

    def drawn(what: str, below: int) -> int:
        return int(below * faults.draw(what, way.cycle, way.sender, way.receiver, way.number))

    flips = 1 + drawn("corrupted bits", faults.equipment.noticed_bits)
    return {drawn(f"corrupted bit {place}", 8 * length) for place in range(flips)}


def _late(faults: Faults, way: Passage) -> tuple[int, tuple[str, ...]]:
    """By how many cycles a frame is late, and why."""
    why = {}
    if slow := _at(faults, "slow", way.step, way.sender):
        why["slow"] = int(slow[0])
    delay = _at(faults, "delay", way.step, way.sender, way.receiver)
    if delay is not None and _strikes_link(faults, "delay", way):
        why["delay"] = int(delay[1])
    if jitter := _at(faults, "jitter", way.step, way.sender, way.receiver):
        draw = faults.draw("jitter", way.cycle, way.sender, way.receiver, way.number)
        why["jitter"] = int((jitter[0] + 1) * draw)
    return sum(why.values()), tuple(word for word, cycles in why.items() if cycles)


def _victims(faults: Faults, way: Passage, has_slot: Callable[[int], bool]) -> list[int]:
    """In whose names the sender also says it."""
    named = [nodes for kind, nodes in faults.standing if kind == "spoof"]
    found = []
    for node, victim in named:
        spoof = _at(faults, "spoof", way.step, node, victim)
        if node == way.sender and spoof is not None and has_slot(victim):
            draw = faults.draw("spoof", way.cycle, node, victim, way.number)
            found += [victim] * (draw < spoof[0])
    return found


def _strikes(faults: Faults, kind: str, way: Passage, receiver: int) -> bool:
    """Return whether a sender's fault affects this frame, for all receivers."""
    numbers = _at(faults, kind, way.step, way.sender)
    draw = faults.draw(kind, way.cycle, way.sender, receiver, way.number)
    return numbers is not None and draw < numbers[0]


def _strikes_link(faults: Faults, kind: str, way: Passage) -> bool:
    """Return whether a link's fault affects this frame."""
    numbers = _at(faults, kind, way.step, way.sender, way.receiver)
    draw = faults.draw(kind, way.cycle, way.sender, way.receiver, way.number)
    return numbers is not None and draw < numbers[0]
