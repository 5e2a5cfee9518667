"""Checks of commands: refuse each one that the network cannot obey now, and say why."""

from collections.abc import Sequence
from math import isfinite

from concord.nodes.changes import Standing
from concord.nodes.commands import (
    Command,
    Configure,
    CutLink,
    HealLink,
    Inject,
    Kill,
    LoseFrames,
    Partition,
    Pause,
    Refused,
    Restart,
    Resume,
    Soothe,
    Speed,
    Step,
    offered,
)
from concord.nodes.faults.active import PLAIN, Equipment
from concord.nodes.faults.vocabulary import CHANNELS, FAULTS, usage

MAX_STEPS_AT_ONCE = 1000
# A user who wants a slower run pauses the network and asks for single steps.
MIN_STEPS_PER_SECOND, MAX_STEPS_PER_SECOND = 0.001, 1000.0


def check_command(
    command: Command,
    neighbours: Sequence[Sequence[int]],
    standing: Standing,
    paused: bool,
    equipment: Equipment = PLAIN,
) -> None:
    """Refuse what cannot be obeyed in a network that stands so.

    Raises:
        Refused: naming the command, its value and the rule.
    """
    match command:
        case Pause() | Resume() | Configure() | Soothe():
            pass
        case Step(count):
            _require(paused, f"step {count}", "the network runs; pause it first")
            allowed = 1 <= count <= MAX_STEPS_AT_ONCE
            _require(allowed, f"step {count}", f"must be 1 to {MAX_STEPS_AT_ONCE}")
        case Speed(rate):
            allowed = rate == 0 or MIN_STEPS_PER_SECOND <= rate <= MAX_STEPS_PER_SECOND
            range_ = f"{MIN_STEPS_PER_SECOND:g} to {MAX_STEPS_PER_SECOND:g} steps/s"
            _require(allowed, f"speed {rate:g}", f"must be {range_}, or 0 for no limit")
        case Kill(node):
            _check_node(f"kill {node}", node, neighbours)
            _require(node not in standing.absent, f"kill {node}", "the node is out already")
            alone = len(standing.absent) + 1 == len(neighbours)
            _require(not alone, f"kill {node}", "it is the last one; end the run instead")
        case Restart(node):
            _check_node(f"restart {node}", node, neighbours)
            _require(node in standing.absent, f"restart {node}", "the node is not out")
        case Partition(nodes):
            _check_partition(nodes, neighbours)
        case Inject():
            check_fault(command, neighbours, equipment)
        case CutLink() | HealLink() | LoseFrames():
            _check_links(command, neighbours)


def check_timely(command: Command) -> None:
    """Refuse what a network in real time cannot obey.

    Raises:
        Refused: naming the command, the rule and the cure.
    """
    match command:
        case Pause() | Resume() | Step() | Speed():
            raise Refused(
                f"{command.__struct_config__.tag}: in real time the clock says when a step begins; "
                "use --driver processes to stop, step or slow a network"
            )
        case Configure():
            raise Refused(
                "set: in real time nobody waits for a node that misses the step from which they "
                "hold; give them before the run, or use --driver processes"
            )
        case _:
            pass


def _check_links(
    command: CutLink | HealLink | LoseFrames, neighbours: Sequence[Sequence[int]]
) -> None:
    match command:
        case CutLink(sender, receiver, both):
            _check_link("cut", sender, receiver, both, neighbours)
        case HealLink(int(sender), int(receiver), both):
            _check_link("heal", sender, receiver, both, neighbours)
        case HealLink(sender, receiver):
            _require(sender is receiver is None, "heal", "name both ends of the link, or neither")
        case LoseFrames(probability, sender, receiver, both):
            allowed = 0 <= probability < 1
            _require(allowed, f"loss {probability:g}", "must be at least 0 and below 1")
            if sender is not None and receiver is not None:
                _check_link("loss on", sender, receiver, both, neighbours)
            else:
                whole = sender is None and receiver is None
                _require(whole, f"loss {probability:g}", "name both ends of the link, or neither")


def _check_node(what: str, node: int, neighbours: Sequence[Sequence[int]]) -> None:
    there = 0 <= node < len(neighbours)
    _require(there, what, f"there are nodes 0 to {len(neighbours) - 1}")


def _check_partition(nodes: Sequence[int], neighbours: Sequence[Sequence[int]]) -> None:
    what = " ".join(("partition", *map(str, nodes)))
    for node in nodes:
        _check_node(what, node, neighbours)
    apart = 0 < len(set(nodes)) < len(neighbours)
    _require(apart, what, "name some of the nodes, and not all of them")


def check_fault(command: Inject, neighbours: Sequence[Sequence[int]], equipment: Equipment) -> None:
    """Refuse a fault that this network cannot have.

    Raises:
        Refused: naming it, its value and the rule.
    """
    kind, nodes, numbers = command.kind, command.nodes, command.numbers
    if kind not in FAULTS:
        raise Refused(f"fault {kind!r}{offered('Faults', kind, FAULTS)}")
    fault = FAULTS[kind]
    named = {"link": (0, 2), "node": (1,), "two nodes": (2,), "channel": (1,), "bus": (0,)}
    whole = len(numbers) == len(fault.numbers) and len(nodes) in named[fault.place]
    _require(whole, kind, f"say {usage(kind)}")
    for number, value in zip(fault.numbers, numbers, strict=True):
        in_range = number.least <= value <= number.most
        allowed = in_range and (not number.is_whole or value == int(value))
        kind_of_number = "a whole number from" if number.is_whole else "from"
        rule = f"{number.name} must be {kind_of_number} {number.least:g} to {number.most:g}"
        _require(allowed, f"{kind} {value:g}", rule)
    if fault.place == "link" and nodes:
        _check_link(kind, nodes[0], nodes[1], command.both, neighbours)
    elif fault.place in ("node", "two nodes"):
        for node in nodes:
            _check_node(f"{kind} {node}", node, neighbours)
        apart = len(set(nodes)) == len(nodes)
        _require(apart, f"{kind} {nodes[0]}", "a node cannot be its own victim")
    _check_need(command, equipment)


def _check_need(command: Inject, equipment: Equipment) -> None:
    """Refuse a fault of what this network has not got."""
    kind, nodes = command.kind, command.nodes
    match FAULTS[kind].needs:
        case "a cluster":
            timed = equipment.cycle_us > 0
            _require(timed, kind, "a bus without time has no slots to miss; choose a --cluster")
            edged = isfinite(equipment.precision_us)
            why = "frames of this bus have identifiers and no slots to miss; choose --bus flexray"
            _require(edged, kind, why)
        case "two channels":
            channels = equipment.channels
            both = len(channels) == len(CHANNELS)
            why = f"the cluster has channel {channels} alone; choose a --cluster that has A and B"
            _require(both, kind, why)
            there = 0 <= nodes[0] < len(CHANNELS)
            _require(there, f"{kind} {nodes[0]}", "there are channels A and B, numbers 0 and 1")
        case "shares of numbers":
            why = "shares of this rule are no numbers; choose rule ci, wac or hcmci"
            _require(bool(equipment.number), kind, why)
        case "shares of beliefs":
            why = "shares of this rule are no beliefs; choose rule ci, wac, trimmed-ci or local"
            _require(equipment.codec is not None, kind, why)


def _check_link(
    verb: str, sender: int, receiver: int, both: bool, neighbours: Sequence[Sequence[int]]
) -> None:
    what = f"{verb} {sender} {receiver}"
    for node in (sender, receiver):
        _check_node(what, node, neighbours)
    heard = sender in neighbours[receiver] or (both and receiver in neighbours[sender])
    _require(heard, what, f"node {receiver} does not hear node {sender}")


def _require(holds: bool, what: str, why: str) -> None:
    if not holds:
        raise Refused(f"{what}: {why}")
