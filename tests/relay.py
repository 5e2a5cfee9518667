"""A TCP relay through which one link of a network goes, so that it can be cut."""

import socket
import struct
import threading
from contextlib import suppress

# Closing with this is a reset: nothing that waits is delivered.
_AT_ONCE = struct.pack("ii", 1, 0)


class Relay:
    """Passes on what comes at `port` to another one."""

    def __init__(self, target: int) -> None:
        self._target, self._dropping, self._refusing = target, False, False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.lost = 0
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def lose(self) -> None:
        """Swallow what comes from now on."""
        self._dropping = True

    def cut(self, *, for_good: bool = False) -> None:
        """Break the link; it can be opened again at once, or never."""
        self._refusing = for_good
        while self._open:
            one = self._open.pop()
            with suppress(OSError):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._dropping = False

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
                try:
                    far = socket.create_connection(("127.0.0.1", self._target))
                except OSError:
                    near.close()
                    continue
                self._open += [near, far]
                for source, sink in ((near, far), (far, near)):
                    source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._pass, args=(source, sink), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                if self._dropping:
                    self.lost += len(data)
                else:
                    sink.sendall(data)
        for one in (source, sink):
            with suppress(OSError):
                one.close()
