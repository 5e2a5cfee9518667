"""The end of a run that all nodes have left for good."""

import threading
from collections.abc import Callable

from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.environment.failures import Deserted
from concord.runtime.processes.environment.notices import Alone

# An environment process that stood still for longer than its lease finds all nodes gone. Links come
# back within a second or two, on a busy machine in three times that.
_RETURN_S = 6.0


class Desertion:
    """Tells the environment process when no node has returned in time."""

    def __init__(self, transport: Transport, notify: Callable[[Alone], None], nodes: int) -> None:
        self._transport, self._notify = transport, notify
        self._names = [str(node) for node in range(nodes)]

    def begin(self) -> None:
        """No node is left: give notice of it in a while."""
        timer = threading.Timer(_RETURN_S, self._notify, (Alone(),))
        timer.daemon = True
        timer.start()

    def end(self, is_deserted: bool) -> None:
        """End the run if no node takes part and none is in reach.

        Raises:
            Deserted: so it is.
        """
        if is_deserted and len(self._transport.missing(self._names)) == len(self._names):
            raise Deserted("no node is left")
