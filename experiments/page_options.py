"""Where a page is, as a user says it."""

import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass

from tyro.conf import UseAppendAction

LOOPBACK = "127.0.0.1"
_MOST = 65535
_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?")


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Where the page is, and how it looks."""

    host: str = LOOPBACK
    """Address to listen at. A browser needs the token of the printed address; nothing is
    encrypted."""
    http_port: int = 8080
    """Port of the page; the next free one if it is taken, any free one for 0."""
    public_name: UseAppendAction[tuple[str, ...]] = ()
    """Name under which a proxy shows the page, such as viz.example.org; repeat it for several."""
    light: bool = False
    """Dark ink on white instead of light on black."""


def check_place(host: str, http_port: int, public_names: Iterable[str] = ()) -> None:
    """Refuse an address at which no page can be: its server would look for one for ever. Pages of
    this process are let in under these public names too.

    Raises:
        ValueError: no port has that number, this machine has no such address, or a name is none.
    """
    for name in public_names:
        if not _NAME.fullmatch(name):
            raise ValueError(
                f"--public-name {name}: must be a host name alone, such as viz.example.org"
            )
        # Only here: commands without a page do not load it.
        from concord.dashboard.access import PUBLIC_NAMES

        PUBLIC_NAMES.add(name.lower())
    if not 0 <= http_port <= _MOST:
        raise ValueError(f"--http-port {http_port}: must be 1 to {_MOST}, or 0 for any free one")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as listener:
            listener.bind(address)
    except (OSError, UnicodeError) as error:
        raise ValueError(
            f"--host {host}: this machine cannot listen there ({error}); give one of its own "
            f"addresses, or leave it out for {LOOPBACK}"
        ) from None
