"""Before the first step: the environment process waits until all others are ready."""

import math
import sys
from collections.abc import Callable, Sequence

from concord.nodes.commands import Answer
from concord.runtime.network.links import ENVIRONMENT, RECORDER
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.environment.decisions import Deserted, compare
from concord.runtime.processes.environment.inbox import EnvironmentInbox
from concord.runtime.processes.environment.notices import Asked, Hello, Presence
from concord.runtime.processes.environment.reports import in_words

# How often the process says which others it waits for.
_TELL_S = 10.0


def gather(
    transport: Transport,
    inbox: EnvironmentInbox,
    nodes: int,
    fingerprint: str,
    hear_of_presence: Callable[[str, bool], None],
    peer_timeout_s: float = math.inf,
) -> None:
    """Join the network, and wait for all other processes; from then on hear who comes and goes.

    Args:
        transport, inbox, nodes, fingerprint: of the network.
        hear_of_presence: told who comes and goes.
        peer_timeout_s: how long no further process may come.

    Raises:
        LinkError: the network cannot be joined.
        Disagreement: a node's setup is another.
        Deserted: some processes cannot be met.
    """
    names = [RECORDER, *map(str, range(nodes))]
    transport.join(ENVIRONMENT, ())
    await_processes(transport, names, peer_timeout_s)
    transport.watch(hear_of_presence)
    for name in transport.missing(names):
        # It was gone again before the watch began.
        hear_of_presence(name, False)
    await_hellos(inbox, nodes, fingerprint)


def await_processes(
    transport: Transport, names: Sequence[str], peer_timeout_s: float = math.inf
) -> None:
    """Wait until processes of all these names are there.

    Raises:
        Deserted: no further one has come for `peer_timeout_s` seconds; it names those that lack.
    """
    waited_s, before = 0.0, len(names)
    while not transport.await_present(names, _TELL_S):
        missing = transport.missing(names)
        waited_s = waited_s + _TELL_S if len(missing) == before else 0.0
        before = len(missing)
        if waited_s >= peer_timeout_s:
            raise Deserted(
                f"{in_words(missing)} cannot be met, although the process is there; no further one "
                f"has come for {waited_s:.0f} s; run `concord doctor`"
            )
        sys.stderr.write(f"the environment waits for {in_words(missing)}\n")


def await_hellos(inbox: EnvironmentInbox, nodes: int, fingerprint: str) -> None:
    """Wait until all nodes have said hello, with our setup.

    Raises:
        Disagreement: a node's setup is another.
    """
    missing = set(range(nodes))
    while missing:
        match inbox.next_notice():
            case Hello() as hello:
                compare(hello, fingerprint)
                missing.discard(hello.node)
            case Presence(node, False):
                # Its next life has to say hello again.
                missing.add(node)
            case Asked(_, answer):
                answer.put(Answer(False, "the run has not begun; try again"))
