"""Which nodes were out of a network, in which steps, and whether that was asked for."""

import msgspec
import numpy as np

from concord.results.records.runs import Runs


class NodeOutage(msgspec.Struct, frozen=True):
    """Nodes that were out together, from `first_step` to before `end_step`; None is to the end.

    `is_asked` says whether a change or a command asked for it; else the process was lost.
    """

    nodes: tuple[int, ...]
    first_step: int
    end_step: int | None
    is_asked: bool

    def nodes_in_words(self) -> str:
        """ "node 3", "nodes 2 and 3", or "nodes 2, 3, 5, ... (7 nodes)"."""
        names = [str(node) for node in self.nodes]
        if len(names) == 1:
            return f"node {names[0]}"
        if len(names) > 6:
            return f"nodes {', '.join(names[:4])}, ... ({len(names)} nodes)"
        return f"nodes {', '.join(names[:-1])} and {names[-1]}"

    def in_words(self) -> str:
        """ "nodes 2 and 3 were out in steps 40 to 59, as asked"."""
        until = "to the end" if self.end_step is None else f"to step {self.end_step - 1}"
        why = "as asked" if self.is_asked else "lost: nothing asked for it"
        was = "was" if len(self.nodes) == 1 else "were"
        return f"{self.nodes_in_words()} {was} out from step {self.first_step} {until}, {why}"


def outages_of(runs: Runs) -> list[NodeOutage]:
    """Return the outages of runs in order. In runs as arrays only what was asked for happens."""
    together: dict[tuple[int, int | None, bool], list[int]] = {}
    for node, first, end, is_asked in sorted(_single(runs)):
        together.setdefault((first, end, is_asked), []).append(node)
    keys = sorted(together, key=lambda key: (key[0], together[key]))
    return [NodeOutage(tuple(together[key]), *key) for key in keys]


def _single(runs: Runs) -> set[tuple[int, int, int | None, bool]]:
    """Node, first step, end, and whether it was asked for, of each outage."""
    if runs.history is not None:
        return {
            (one.node, one.first_step, one.end_step, one.why == "asked")
            for one in runs.history.absent_steps
            if one.why != "late" and one.first_step < runs.steps
        }
    out = np.isnan(runs.mean[0]).all(axis=-1)
    # The sensors of a measurement bus believe nothing at any time.
    out &= ~out.all(axis=0)
    edges = np.diff(out.astype(np.int8), axis=0, prepend=0)
    found = set()
    for step, node in np.argwhere(edges == 1).tolist():
        back = np.flatnonzero(edges[step:, node] == -1)
        found.add((node, step, step + int(back[0]) if len(back) else None, True))
    return found
