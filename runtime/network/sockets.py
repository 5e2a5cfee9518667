"""Unix sockets of one network, in a folder that no other user of the machine can open."""

import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

# The path of a socket has at most 107 bytes on Linux and 103 on macOS; zenoh appends `.lock`.
_LONGEST_FOLDER = 80
# Other characters have a meaning in an endpoint of zenoh.
_PLAIN = re.compile(r"[A-Za-z0-9/._-]+")


@contextmanager
def socket_folder() -> Iterator[str]:
    """Make a new folder of mode 0700 for the sockets of one network, and remove it at the end.

    Raises:
        ValueError: no folder for temporary files has room and a short name.
    """
    tried = dict.fromkeys((os.environ.get("XDG_RUNTIME_DIR", ""), tempfile.gettempdir(), "/tmp"))
    for parent in filter(_PLAIN.fullmatch, tried):
        if len(parent) > _LONGEST_FOLDER - len("/concord-12345678"):
            continue
        try:
            made = tempfile.TemporaryDirectory("", "concord-", parent, ignore_cleanup_errors=True)
        except OSError:
            continue
        with made as folder:
            yield folder
        return
    raise ValueError(
        f"sockets: no folder among {', '.join(filter(None, tried))} takes the sockets of the "
        "network; set TMPDIR to one with a short name, or talk over loopback ports with --port 0"
    )


def in_folder(folder: str, names: Sequence[str]) -> dict[str, str]:
    """Return the endpoint of a unix socket for each name."""
    return {name: f"unixsock-stream/{folder}/{name}" for name in names}
