"""`concord dashboard`: a network that runs, in the browser; attaches and detaches unnoticed."""

import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.network_file import read_network
from experiments.replay_command import PageOptions
from experiments.user_errors import user_errors


@dataclass(frozen=True, kw_only=True)
class AttachOptions:
    """Which network."""

    connect: tuple[str, ...] = ()
    """All endpoints of the network, as network.json in the run's folder names them."""
    folder: Path | None = None
    """The folder of the run, in place of its endpoints."""
    run: str | None = None
    """The name of the run; the only one that answers when left out."""
    with_launcher: bool = False
    """End when standard input closes: for whoever starts this page."""


def dashboard(
    network: Annotated[AttachOptions, tyro.conf.arg(name="")],
    options: Annotated[PageOptions, tyro.conf.arg(name="")],
) -> None:
    """Watch and control a network that runs, in the browser."""
    from dashboard.serve import open_network

    with user_errors():
        connect, run = network.connect, network.run
        if network.folder is not None:
            there = read_network(network.folder)
            connect, run = tuple(there.connect), there.run
        if not connect:
            raise ValueError(
                "--connect: there is no endpoint; give those of network.json in the folder of the "
                "run, or --folder with that folder"
            )
        page = open_network(
            connect, run, network.folder, options.host, options.http_port, options.light
        )
    sys.stderr.write(f"dashboard at http://{options.host}:{page.port}  (Ctrl-C leaves)\n")
    sys.stderr.flush()
    launcher_gone = threading.Event()
    if network.with_launcher:
        threading.Thread(target=_await_end, args=(launcher_gone,), daemon=True).start()
    try:
        page.run(launcher_gone.is_set)
    finally:
        page.close()


def _await_end(gone: threading.Event) -> None:
    sys.stdin.buffer.read()
    gone.set()
