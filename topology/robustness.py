"""Whether honest nodes agree in a graph in which each of them hears a few liars.

A set of nodes is r-reachable if one of them hears r nodes outside of it. A graph is r-robust if of
any two sets of nodes that have no node in common one at least is. If every node drops up to F
extremes, and hears F liars at most, honest nodes agree if the graph is (2 F + 1)-robust.

Source: LeBlanc, Zhang, Koutsoukos and Sundaram (2013), Resilient asymptotic consensus in robust
networks, IEEE Journal on Selected Areas in Communications 31(4), where it is proved for scalars.
"""

from collections.abc import Sequence

import numpy as np

# All sets of so many nodes are looked at; deciding it is as hard as that.
EXACT_NODES = 16


def is_robust(neighbours: Sequence[Sequence[int]], reach: int) -> bool | None:
    """Return whether a graph is `reach`-robust, whose nodes hear these; None where it is not known.

    It is known for up to `EXACT_NODES` nodes, for degrees of half of the nodes and more, and where
    a node hears too few.
    """
    nodes = len(neighbours)
    least = min((len(heard) for heard in neighbours), default=0)
    if reach <= 0 or nodes <= 1:
        return reach <= 0
    if reach > (nodes + 1) // 2 or (reach > 1 and least < reach):
        return False
    if least >= nodes // 2 + reach - 1:
        return True
    return _is_robust(neighbours, reach) if nodes <= EXACT_NODES else None


def _is_robust(neighbours: Sequence[Sequence[int]], reach: int) -> bool:
    """Check all sets of nodes; each set is a number whose bits mark its nodes."""
    nodes = len(neighbours)
    sets = np.arange(1 << nodes, dtype=np.uint32)
    shut = sets > 0
    for node, heard in enumerate(neighbours):
        mask = np.uint32(sum(1 << neighbour for neighbour in heard))
        inside = (sets >> np.uint32(node)) & 1
        outside = np.bitwise_count(mask & ~sets)
        shut &= (inside == 0) | (outside < reach)
    # Whether a set or a part of it is shut: one node more at a time.
    holds_shut = shut.copy().reshape((2,) * nodes)
    for axis in range(nodes):
        without, with_node = np.take(holds_shut, 0, axis), np.take(holds_shut, 1, axis)
        holds_shut = np.stack((without, without | with_node), axis=axis)
    rest = sets ^ np.uint32((1 << nodes) - 1)
    return not (shut & holds_shut.reshape(-1)[rest]).any()
