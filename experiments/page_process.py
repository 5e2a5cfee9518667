"""The dashboard beside a run: a process of its own that ends with the launcher.

The network begins paused and waits for the first user of the page, for a limited time, so that
the user sees the beginning. The launcher writes the token of the page to its standard input, and
`RUN_IS_OVER` when the run is over, or `NETWORK_IS_GONE`. The page writes its port to its standard
output, `NETWORK_RUNS` when it has resumed the network, and `RUN_AGAIN` when the user presses that
button. The launcher resumes the network of a page that ends before.
"""

import queue
import secrets
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path

from concord.runtime.interpreter import fresh_command, fresh_variables

RUN_IS_OVER, NETWORK_IS_GONE = b"over\n", b"gone\n"
NETWORK_RUNS, RUN_AGAIN = b"runs\n", b"again\n"
PORT = b"port "
_END_S = 5.0
# A launcher whose terminal nobody looks at ends as well.
_OUTLIVES_S = 3600.0
# How often the launcher looks whether it is to end.
_LOOK_S = 0.5


class PageProcess:
    """The page of a run, started when the run has begun.

    The page of the next run takes the same port and token, so that browsers reconnect by
    themselves.
    """

    def __init__(self, http_port: int, public_names: Sequence[str] = ()) -> None:
        self._public = [word for name in public_names for word in ("--public-name", name)]
        self._http_port, self._token = http_port, secrets.token_urlsafe(24)
        self._process: subprocess.Popen[bytes] | None = None
        self._asks_again: queue.Queue[bool] = queue.Queue()

    def start(self, folder: Path) -> None:
        """Start the page of the run in this folder, whose network is ready and paused."""
        # The page of the run before has stayed until now.
        self.close()
        place = ("--folder", str(folder), "--http-port", str(self._http_port), *self._public)
        self._process = subprocess.Popen(
            fresh_command("concord.experiments", "dashboard", *place, "--with-launcher"),
            env=fresh_variables(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # Ctrl-C is for the launcher; the page ends when its standard input closes.
            start_new_session=True,
        )
        self._asks_again = queue.Queue()
        told = self._process, self._asks_again, folder
        threading.Thread(target=self._hear, args=told, daemon=True).start()
        self._tell(f"{self._token}\n".encode())

    def _hear(
        self, process: subprocess.Popen[bytes], asks_again: "queue.Queue[bool]", folder: Path
    ) -> None:
        """Runs on: a thread of its own, until the page ends."""
        assert process.stdout is not None, "it was started with a pipe"
        is_paused = True
        for line in process.stdout:
            if line.startswith(PORT):
                self._http_port = int(line.removeprefix(PORT))
            elif line == NETWORK_RUNS:
                is_paused = False
            elif line == RUN_AGAIN:
                asks_again.put(True)
        asks_again.put(False)
        if is_paused and self._process is process:
            _resume(folder)

    def _tell(self, line: bytes) -> None:
        assert self._process is not None, "the caller has looked"
        assert self._process.stdin is not None, "it was started with a pipe"
        # The page may have ended before the run.
        with suppress(BrokenPipeError):
            self._process.stdin.write(line)
            self._process.stdin.flush()

    def tell_end(self) -> None:
        """Have the page say that the run is over."""
        if self._process is not None:
            self._tell(RUN_IS_OVER)

    def outlive_network(self) -> None:
        """Have the page say that its network is gone, and keep it until Ctrl-C."""
        if self._process is not None and self._process.poll() is None:
            self._tell(NETWORK_IS_GONE)
            sys.stderr.write("the network is gone; its page stays until Ctrl-C\n")
            with suppress(KeyboardInterrupt, subprocess.TimeoutExpired):
                self._process.wait(_OUTLIVES_S)

    def stay(self) -> bool:
        """Wait until the user presses Ctrl-C or the page has ended; return True as soon as the user
        asks for the same run again."""
        if self._process is None or self._process.poll() is not None:
            return False
        sys.stdout.flush()
        sys.stderr.write(
            "the run is over; its page stays until Ctrl-C, and its button runs it again\n"
        )
        with suppress(KeyboardInterrupt):
            while True:
                # The kernel may give the signal to another thread, which does not end a `get`.
                with suppress(queue.Empty):
                    return self._asks_again.get(timeout=_LOOK_S)
        return False

    def close(self) -> None:
        """End the page."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None, "it was started with a pipe"
        with suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _resume(folder: Path) -> None:
    """Resume the network of a run whose page ended before it did so."""
    # Only here: a launcher whose page lives needs no client.
    from concord.nodes.commands import Resume
    from concord.runtime.network.control_client import Client
    from concord.runtime.network.network_file import read_network

    # A network that ends has no use for it.
    with suppress(ValueError, OSError):
        there = read_network(folder)
        with closing(Client(there.connect, there.run)) as client:
            client.command(Resume())
        sys.stderr.write("the page ended before the first step; the network goes on without it\n")
