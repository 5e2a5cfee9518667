"""The dashboard beside a run: a process of its own that ends with the launcher.

The network waits for the first user of the page, for a limited time, so that the user sees the
beginning. The launcher writes `RUN_IS_OVER` to the page's standard input when the run is over.
"""

import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from concord.nodes.commands import Pause
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.runtime.network.network_file import read_network

RUN_IS_OVER = b"over\n"
_END_S = 5.0


class PageProcess:
    """The page of a run, started when the run has begun."""

    def __init__(self, folder: Path, http_port: int) -> None:
        self._folder, self._http_port = folder, http_port
        self._process: subprocess.Popen[bytes] | None = None

    def beside(self, on_step: Callable[[int], None]) -> Callable[[int], None]:
        """`on_step`, which at its first call also starts the page."""

        def told(step: int) -> None:
            if self._process is None:
                self._start()
            on_step(step)

        return told

    def _start(self) -> None:
        # A session with a network takes longer to load than all else here.
        from concord.runtime.network.control_client import Client

        network = read_network(self._folder)
        client = Client(network.connect, network.run)
        client.command(Pause())
        client.close()
        place = ("--folder", str(self._folder), "--http-port", str(self._http_port))
        self._process = subprocess.Popen(
            fresh_command("concord.experiments", "dashboard", *place, "--with-launcher"),
            env=fresh_variables(),
            stdin=subprocess.PIPE,
            # Ctrl-C is for the launcher; the page ends when its standard input closes.
            start_new_session=True,
        )

    def tell_end(self) -> None:
        """Have the page say that the run is over."""
        if self._process is None:
            return
        assert self._process.stdin is not None, "it was started with a pipe"
        # The page may have ended before the run.
        with suppress(BrokenPipeError):
            self._process.stdin.write(RUN_IS_OVER)
            self._process.stdin.flush()

    def stay(self) -> None:
        """Wait until the user presses Ctrl-C, or the page has ended."""
        if self._process is None or self._process.poll() is not None:
            return
        sys.stdout.flush()
        sys.stderr.write("the run is over; its page stays until Ctrl-C\n")
        with suppress(KeyboardInterrupt):
            self._process.wait()

    def close(self) -> None:
        """End the page."""
        if self._process is None:
            return
        assert self._process.stdin is not None, "it was started with a pipe"
        self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
