"""Search the schedule, independently of the rule, for the records that a node can hold at most.

Each sender sends each record that it holds. Each receiver then holds these records too, until the
window has passed. A rule that drops no record reaches exactly this bound.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from concord.bus.schedule import Schedule
from concord.nodes.messages import Grant, decode

Label = tuple[int, int]  # step, source
Held = list[set[Label]]  # of each node
Winners = Mapping[tuple[int, int], Sequence[int]]  # of (cycle, group)


def reachable(
    schedule: Schedule,
    neighbours: Sequence[Sequence[int]],
    rounds: int,
    window_steps: int,
    taken: Collection[Label],
    winners: Winners,
    arrives: Callable[[int, int, int], bool],
) -> Iterable[Held]:
    """Yield the records that each node can hold at the end of step 0, 1, 2, ...

    `taken` are the labels of all records; `winners` had the dynamic slots; `arrives(sender,
    receiver, cycle)` says whether a share came through.
    """
    held: Held = [set() for _ in neighbours]
    by_step: dict[int, list[Label]] = {}
    for label in taken:
        by_step.setdefault(label[0], []).append(label)
    step = 0
    while True:
        held = [{label for label in some if label[0] > step - window_steps} for some in held]
        for label in by_step.get(step, ()):
            held[label[1]].add(label)
        for cycle in range(step * rounds, (step + 1) * rounds):
            for number, group in enumerate(schedule.groups(cycle)):
                before = [set(some) for some in held]
                for sender in (*group.senders, *winners.get((cycle, number), ())):
                    for receiver, heard in enumerate(neighbours):
                        if sender in heard and arrives(sender, receiver, cycle):
                            held[receiver] |= before[sender]
        yield [set(some) for some in held]
        step += 1


def winners_of(messages: Iterable[tuple[str, bytes]]) -> Winners:
    """Return the winners of the dynamic slots, from a recording."""
    grants: list[Grant] = [decode(topic, data) for topic, data in messages if topic == "grant"]
    return {(grant.cycle, grant.group): grant.winners for grant in grants}
