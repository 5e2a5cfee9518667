"""Changes to a network while it runs; each takes effect at the start of a step.

The environment announces a change with the first heartbeat of the step from which it holds, when
every node has finished the step before. So all nodes apply it at once, in every driver. `Standing`
is the sum of all changes so far.
"""

from typing import Any, Self

import msgspec
from msgspec.structs import replace

from concord.nodes.bounds import Instant, NodeIndex

Settings = dict[str, int | float | str]


class Left(msgspec.Struct, frozen=True, tag="left", tag_field="what"):
    """A node is out on command: no process waits for it from this step on."""

    node: NodeIndex


class Gone(msgspec.Struct, frozen=True, tag="gone", tag_field="what", omit_defaults=True):
    """A node's process has died or hangs: every process stops waiting for it at once.

    The next heartbeat says since which `step` the node is out, so that all nodes apply the end in
    the same step.
    """

    node: NodeIndex
    step: Instant | None = None


class Joined(msgspec.Struct, frozen=True, tag="joined", tag_field="what", omit_defaults=True):
    """A node is back, and begins the step with this belief: mean (n,), upper triangle of the
    covariance; None for the scenario's own prior.

    The belief is that of the step before, or of an earlier `step`, from which the node predicts
    it; `control` (p,) drove the plant last.
    """

    node: NodeIndex
    mean: list[float | None] | None = None
    cov: list[float | None] | None = None
    step: int | None = None
    control: list[float] | None = None


class Present(msgspec.Struct, frozen=True, tag="present", tag_field="what"):
    """A node takes part, although the node `mistaken` took it for out.

    The environment had not said so: a message was forged, or lost.
    """

    node: NodeIndex
    mistaken: NodeIndex


class Cut(msgspec.Struct, frozen=True, tag="cut", tag_field="what"):
    """The link from a sender to a receiver loses everything."""

    sender: int
    receiver: int


class Healed(msgspec.Struct, frozen=True, tag="healed", tag_field="what"):
    """The link from a sender to a receiver is no longer cut."""

    sender: int
    receiver: int


class Loss(msgspec.Struct, frozen=True, tag="loss", tag_field="what", omit_defaults=True):
    """A link, or every link that has no loss of its own, loses this part of its frames."""

    probability: float
    sender: int | None = None
    receiver: int | None = None


class Fault(msgspec.Struct, frozen=True, tag="fault", tag_field="what"):
    """Something is wrong from a step on, in the words of `nodes/faults/vocabulary.py`.

    It holds for `nodes` (a node; sender and receiver; the number of a channel), or for every link
    where there are none. `numbers` say how much of it; it is off where the first of them is 0.
    """

    kind: str
    nodes: tuple[int, ...]
    numbers: tuple[float, ...]
    first_step: int = 0
    first_cycle: int = 0


class Calm(msgspec.Struct, frozen=True, tag="calm", tag_field="what"):
    """Withdraw all faults of links, sensors, nodes and the bus.

    Absent nodes stay absent, and the scenario's own links lose frames as before.
    """


class Set(msgspec.Struct, frozen=True, tag="settings", tag_field="what"):
    """Fields of the scenario have other values: all that were ever set. Communication cycles of the
    step begin at `first_cycle`."""

    settings: Settings
    first_cycle: Instant = 0


class PaceChange(msgspec.Struct, frozen=True, tag="pace", tag_field="what"):
    """How fast the network goes; 0 steps per second is as fast as possible."""

    paused: bool
    steps_per_second: float


Change = Left | Gone | Joined | Present | Cut | Healed | Loss | Fault | Calm | Set | PaceChange


class Event(msgspec.Struct, frozen=True):
    """Environment to subscribers: a change, and the first step for which it holds."""

    step: Instant
    change: Change


class Standing(msgspec.Struct, frozen=True):
    """State of a network after all changes so far.

    Attributes:
        out_since: (node, step) of the nodes that are out, and since when. settings: fields of the
            scenario that were set.
        loss: of every link that has none of its own, None for the scenario's.
        losses: (sender, receiver, probability) of links that have. cuts: (sender, receiver).
        first_step, first_cycle: where the present settings begin.
        faults: the last of each kind and place, in that order.
    """

    out_since: tuple[tuple[int, int], ...] = ()
    settings: Settings = {}
    loss: float | None = None
    losses: tuple[tuple[int, int, float], ...] = ()
    cuts: tuple[tuple[int, int], ...] = ()
    first_step: int = 0
    first_cycle: int = 0
    faults: tuple[Fault, ...] = ()

    @property
    def absent(self) -> tuple[int, ...]:
        """The nodes that are out, ascending."""
        return tuple(node for node, _ in self.out_since)

    def left(self, node: int, step: int) -> Self:
        """Return the state in which a node is out from a step on, if it was not out before."""
        since = {node: step, **dict(self.out_since)}
        return replace(self, out_since=tuple(sorted(since.items())))

    def joined(self, node: int) -> Self:
        """Return the state in which a node takes part."""
        since = tuple(one for one in self.out_since if one[0] != node)
        return replace(self, out_since=since)


UNCHANGED = Standing()


class Welcome(msgspec.Struct, frozen=True):
    """Environment to a returned node: the step from which it takes part, and the settings."""

    node: int
    step: int
    standing: Standing
    joined: Joined


def after(standing: Standing, step: int, change: Change) -> Standing:
    """Return the state of the network from `step` on, when a change takes effect there."""
    match change:
        case Gone(node, int(first_step)):
            return standing.joined(node).left(node, first_step)
        case Left(node) | Gone(node):
            return standing.left(node, step)
        case Joined(node) | Present(node):
            return standing.joined(node)
        case Cut(sender, receiver):
            return replace(standing, cuts=tuple(sorted({*standing.cuts, (sender, receiver)})))
        case Healed(sender, receiver):
            cuts = tuple(cut for cut in standing.cuts if cut != (sender, receiver))
            return replace(standing, cuts=cuts)
        case Loss(probability, None) | Loss(probability, _, None):
            return replace(standing, loss=probability)
        case Loss(probability, sender, receiver):
            losses: dict[Any, float] = {(s, r): p for s, r, p in standing.losses}
            losses[sender, receiver] = probability
            links = tuple((s, r, p) for (s, r), p in sorted(losses.items()))
            return replace(standing, losses=links)
        case Fault(kind, nodes):
            others = [one for one in standing.faults if (one.kind, one.nodes) != (kind, nodes)]
            faults = sorted([*others, change], key=lambda one: (one.kind, one.nodes))
            return replace(standing, faults=tuple(faults))
        case Calm():
            return replace(standing, loss=None, losses=(), cuts=(), faults=())
        case Set(settings, first_cycle):
            return replace(standing, settings=settings, first_step=step, first_cycle=first_cycle)
        case PaceChange():
            return standing


def without_return(changes: tuple[Change, ...], node: int) -> tuple[Change, ...]:
    """Changes without the return of a node: who is told of it after its end would wait for it."""
    return tuple(
        change for change in changes if not (isinstance(change, Joined) and change.node == node)
    )


def since_return(changes: tuple[Change, ...], node: int) -> tuple[Change, ...]:
    """Return the changes after the return of a node, whose welcome told it of those before."""
    returns = [
        place
        for place, change in enumerate(changes)
        if isinstance(change, Joined) and change.node == node
    ]
    return changes[returns[-1] + 1 :] if returns else changes
