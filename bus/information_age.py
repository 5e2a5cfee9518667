"""Age of information: how old the newest reading of any node is at any other node.

A share carries all that its sender holds, so a reading moves one link further with each share. The
newest steps that nodes know are a max-plus linear system: over a cycle, each node's become the
maximum of its own and those of the senders it hears. A schedule without contention repeats, and so
do the ages once every reading has crossed the graph; their greatest value is exact (Baccelli,
Cohen, Olsder and Quadrat 1992, Synchronization and Linearity, section 3.7).

Where nodes contend, each sends once at least in a number of cycles (`bus/longest_wait.py`). A
reading then moves one link further within as many cycles, and the slowest of the shortest ways
bounds the age. This assumes that a node asks in all cycles in which a neighbour lacks a reading
that it has, and that its share has room for all of these.
"""

from collections.abc import Callable, Sequence
from math import lcm

import numpy as np

from concord.bus.longest_wait import LongestWait
from concord.bus.schedule import Schedule

Flags = Callable[[int], np.ndarray]
"""Cycle, or step -> (N,) what is true of each node then."""


def worst_age_steps(
    schedule: Schedule, neighbours: Sequence[Sequence[int]], rounds: int
) -> int | None:
    """The greatest age at the end of a step, in steps, where all nodes take readings in every step,
    on links that lose nothing.

    None where schedule and graph bound it not: nodes contend for slots, or a node never hears of
    another.
    """
    if any(schedule.contenders(cycle) for cycle in range(schedule.period)):
        return None
    nodes = schedule.nodes

    def sent(cycle: int) -> np.ndarray:
        return np.isin(np.arange(nodes), schedule.static_senders(cycle))

    def taken(_step: int) -> np.ndarray:
        return np.ones(nodes, dtype=bool)

    period_steps = lcm(schedule.period, rounds) // rounds
    # A reading that moves at all moves one link in a period.
    settled_steps = nodes * period_steps
    steps = settled_steps + 2 * period_steps
    ages = greatest_ages_steps(schedule, neighbours, rounds, steps, sent, taken)
    before, last = ages[-2 * period_steps : -period_steps], ages[-period_steps:]
    return int(last.max()) if last.max() <= before.max() else None


def worst_contended_age_steps(
    schedule: Schedule, neighbours: Sequence[Sequence[int]], rounds: int, wait: LongestWait
) -> int | None:
    """As `worst_age_steps`, where no contender waits for longer than `wait`: an upper bound.

    None where a node never hears of another that may send.
    """
    nodes = range(schedule.nodes)
    gaps = np.array([_longest_gap(schedule, node, wait.next_cycles) for node in nodes])
    # Cycles until each node (row) has a reading of a source (column).
    cycles = np.where(np.eye(schedule.nodes, dtype=bool), 0.0, np.inf)
    for _ in nodes:
        for node, heard in enumerate(neighbours):
            for sender in heard:
                cycles[node] = np.minimum(cycles[node], cycles[sender] + gaps[sender])
    worst = cycles[:, np.isfinite(gaps)].max(initial=0)
    if not np.isfinite(worst):
        return None
    # The first of the senders may still wait for its first win.
    worst += wait.first_cycles - wait.next_cycles
    return max(0, -(-int(worst) // rounds) - 1)


def _longest_gap(schedule: Schedule, node: int, wait_cycles: int) -> float:
    """In how many cycles in a row a node sends once at least; infinite for one that never may."""
    rows = len(schedule.static_table)
    sends = [cycle for cycle in range(2 * rows) if node in schedule.static_senders(cycle)]
    gaps = [float(np.diff(sends).max())] if sends else []
    if any(node in row for row in schedule.contender_table):
        gaps.append(wait_cycles)
    return min(gaps, default=np.inf)


def greatest_ages_steps(
    schedule: Schedule,
    neighbours: Sequence[Sequence[int]],
    rounds: int,
    steps: int,
    sent: Flags,
    taken: Flags,
) -> np.ndarray:
    """The greatest age (steps,) over all pairs of nodes at the end of each step, in steps: for how
    long a node has lacked readings that another has taken.

    Args:
        schedule: who composes shares together.
        neighbours: those that each node hears.
        rounds: cycles of a step.
        steps: how many.
        sent: of a cycle, who has sent a share. Winners of slots that nodes contend for count as
            sending at its end.
        taken: of a step, who has taken a reading.
    """
    nodes = schedule.nodes
    hears = np.zeros((nodes, nodes), dtype=bool)
    for node, heard in enumerate(neighbours):
        hears[node, list(heard)] = True
    takes = np.array([taken(step) for step in range(steps)])
    own = np.maximum.accumulate(np.where(takes, np.arange(steps)[:, None], -1), axis=0)
    first = first_newer(own)
    newest = np.full((nodes, nodes), -1)  # of each source (column), known to each node (row)
    greatest = np.empty(steps, dtype=int)
    for step in range(steps):
        np.fill_diagonal(newest, own[step])
        for cycle in range(step * rounds, (step + 1) * rounds):
            has_sent = sent(cycle)
            for group in _senders(schedule, cycle):
                senders = [node for node in group if has_sent[node]]
                newest = np.maximum(newest, _heard(newest, hears, senders))
        greatest[step] = lags_steps(newest, first, step).max()
    return greatest


def first_newer(own: np.ndarray) -> np.ndarray:
    """The first step (S + 1, N) at which a source holds a newer reading than that of a step.

    The steps are -1, 0, ..., and `own` (S, N) is the newest that each source holds at the end of
    each step. S stands for never.
    """
    asked = np.arange(-1, len(own))
    return np.stack([np.searchsorted(one, asked, side="right") for one in own.T], axis=1)


def lags_steps(newest: np.ndarray, first: np.ndarray, step: int) -> np.ndarray:
    """For how many steps each node (row) has lacked a reading that a source (column) holds.

    It counts at the end of a step, which is included. 0: the node knows all.
    """
    return np.maximum(0, step + 1 - first[newest + 1, np.arange(newest.shape[-1])])


def _senders(schedule: Schedule, cycle: int) -> list[Sequence[int]]:
    """The nodes that may send in a cycle: those together that compose their shares at once."""
    groups = schedule.groups(cycle)
    contenders = schedule.contenders(cycle)
    if len(groups) == 1:
        return [(*groups[0].senders, *contenders)]
    return [*(group.senders for group in groups if group.senders), contenders]


def _heard(newest: np.ndarray, hears: np.ndarray, senders: Sequence[int]) -> np.ndarray:
    """The newest that each node hears (N, N) of each source from these senders."""
    heard = np.full_like(newest, -1)
    for sender in senders:
        heard[hears[:, sender]] = np.maximum(heard[hears[:, sender]], newest[sender])
    return heard
