"""How anyone watches and controls a network that runs, without disturbing it (docs/control.md)."""

import time
from collections.abc import Callable, Sequence

import msgspec

from concord.nodes.commands import Answer, Command
from concord.runtime.network.links import ZenohEndpoints, checked_run
from concord.runtime.network.zenoh_transport import LinkError, Transport
from concord.runtime.whole_steps import EVENTS_ALONE, Handover

_CONNECT_S = 3.0
_HANDOVER_S = 0.5


class NotThere(ValueError):
    """There is no network at the endpoints that were given."""


class Client:
    """A client that watches a network and may command it; close it to leave."""

    def __init__(
        self, connect: Sequence[str], run: str | None = None, keys: str | None = None
    ) -> None:
        """Connect to a network, whatever its run is called if nobody says; `keys` is a file of
        `concord keys` for one that is guarded.

        Raises:
            NotThere: nobody answers at these endpoints.
            ValueError: the run has a name that is none.
        """
        self._connect, self._keys = tuple(connect), keys
        # Also what a network calls itself becomes a part of keys.
        self.run = checked_run(run if run is not None else self._name())
        self._transport = self._open(self.run)

    def _open(self, run: str) -> Transport:
        try:
            return Transport(
                run, ZenohEndpoints("peer", (), self._connect, _CONNECT_S, self._keys), [], 1
            )
        except LinkError:
            raise self._nobody() from None

    def _nobody(self) -> NotThere:
        where = ", ".join(self._connect)
        why = "has the run ended?" if self._keys is None else "has it ended, or may these keys not?"
        return NotThere(f"no network answers at {where}; {why}")

    def _name(self) -> str:
        anybody = self._open("*")
        try:
            return msgspec.json.decode(self._ask(anybody, "state", b""))["run"]
        finally:
            anybody.close()

    def _ask(self, transport: Transport, topic: str, payload: bytes) -> bytes:
        # Declarations of the environment process may still be on their way to us.
        deadline = time.monotonic() + _CONNECT_S
        while time.monotonic() < deadline:
            answer = transport.ask(topic, payload, 2 * _CONNECT_S)
            if answer is not None:
                return answer
            time.sleep(0.02)
        raise self._nobody()

    def state(self) -> dict:
        """Return the state of the network: the fields of
        `concord.runtime.processes.environment.notices.NetworkState` as plain data.

        Raises:
            NotThere: nobody answers.
        """
        return msgspec.json.decode(self._ask(self._transport, "state", b""))

    def command(self, command: Command) -> Answer:
        """Ask for something: whether it was accepted, or why not.

        Raises:
            NotThere: nobody answers.
        """
        answer = self._ask(self._transport, "control", msgspec.json.encode(command))
        return msgspec.json.decode(answer, type=Answer)

    def events(self) -> list[bytes]:
        """Return all events so far, as they are recorded; none where the recorder is silent."""
        answer = self._transport.ask("handover", EVENTS_ALONE)
        return msgspec.msgpack.decode(answer, type=Handover).events if answer else []

    def handover(self) -> Handover | None:
        """Return the newest whole step with events and readings so far; None before the first step
        is over.

        Raises:
            msgspec.MsgspecError: the recorder is of another version.
        """
        # The recorder's declaration may still be on its way to us.
        deadline = time.monotonic() + _HANDOVER_S
        answer = self._transport.ask("handover")
        while answer is None and time.monotonic() < deadline:
            time.sleep(0.02)
            answer = self._transport.ask("handover")
        return msgspec.msgpack.decode(answer, type=Handover) if answer else None

    def listen(self, topic: str, heard: Callable[[str, bytes], None]) -> Callable[[], None]:
        """Have `heard(topic, bytes)` called, in another thread, for what is recorded on a topic
        such as `estimate/*` or `event`; returns what ends it."""
        return self._transport.listen(
            f"watch/{topic}", lambda name, data: heard(name.removeprefix("watch/"), data)
        )

    def close(self) -> None:
        """Leave; the network does not notice."""
        self._transport.close()
