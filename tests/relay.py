"""A TCP relay through which one link of a network goes, so that it can be cut."""

import socket
import struct
import threading
from contextlib import suppress
from dataclasses import dataclass

# Closing with this is a reset: nothing that waits is delivered.
_AT_ONCE = struct.pack("ii", 1, 0)


@dataclass
class _Link:
    """Two sockets, and whether what comes over them is swallowed.

    The link that replaces one that was cut passes on all its bytes. Otherwise its handshake could
    be lost, and zenoh would wait ten seconds for the answer.
    """

    near: socket.socket
    far: socket.socket
    is_dropping: bool = False


class Relay:
    """Passes on what comes at `port` to another one."""

    def __init__(self, target: int) -> None:
        self._target, self._refusing = target, False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.lost = 0
        self._open: list[_Link] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def lose(self) -> None:
        """Swallow what comes over the links that are open now."""
        for link in self._open:
            link.is_dropping = True

    def cut(self, *, for_good: bool = False) -> None:
        """Break the link; it can be opened again at once, or never."""
        self._refusing = for_good
        links, self._open = self._open, []
        for link in links:
            for one in (link.near, link.far):
                with suppress(OSError):
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
                    one.shutdown(socket.SHUT_RDWR)
                one.close()

    def close(self) -> None:
        """No more links."""
        self._listener.close()
        self.cut(for_good=True)

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if self._refusing:
                    near.close()
                    continue
                with suppress(OSError):
                    self._join(near)

    def _join(self, near: socket.socket) -> None:
        """Pass on both ways; an error here ends this link alone."""
        try:
            far = socket.create_connection(("127.0.0.1", self._target))
        except OSError:
            near.close()
            raise
        for one in (near, far):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link = _Link(near, far)
        self._open.append(link)
        for passing in ((link, near, far), (link, far, near)):
            threading.Thread(target=self._pass, args=passing, daemon=True).start()

    def _pass(self, link: _Link, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                if link.is_dropping:
                    self.lost += len(data)
                else:
                    sink.sendall(data)
        # Closing alone leaves a thread that reads the socket, and so the link, as they are.
        for one in (source, sink):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
