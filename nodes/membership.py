"""How the process of a node belongs to a network of processes."""

from collections.abc import Collection

import msgspec

from nodes.links import Links
from nodes.node_state import NodeConfig


class Membership(msgspec.Struct, frozen=True):
    """All that the process of a node is told, whether it keeps time or not.

    Attributes:
        run: the name of the run, below which all its topics lie.
        links: how this process connects.
        config: what the node is.
        peers: whom it hears or who hear it; all must be there before the first share.
        fingerprint: digest of the setup; the world refuses another than its own.
        late: it joins a network that may run already.
        patience_s: where nobody else does, ends the process when it has been without the world
            for so long.
    """

    run: str
    links: Links
    config: NodeConfig
    peers: Collection[int]
    fingerprint: str
    late: bool = False
    patience_s: float | None = None
