"""Unix sockets of one network, in a folder that no other user of the machine can open."""

import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

# The path of a socket has at most 107 bytes on Linux and 103 on macOS; zenoh appends `.lock`.
_LONGEST_FOLDER = 80
# Other characters have a meaning in an endpoint of zenoh.
_PLAIN = re.compile(r"[A-Za-z0-9/._-]+")
_PREFIX = "concord-"
# Processes of the network hold a lock on this file; the kernel takes it back at their ends.
_NEW, _HELD = "new", "held"


@contextmanager
def socket_folder() -> Iterator[str]:
    """Make a new folder of mode 0700 for the sockets of one network, and remove it at the end.

    Folders of networks that were killed are removed as well.

    Raises:
        ValueError: no folder for temporary files has room and a short name.
    """
    tried = dict.fromkeys((os.environ.get("XDG_RUNTIME_DIR", ""), tempfile.gettempdir(), "/tmp"))
    for parent in filter(_PLAIN.fullmatch, tried):
        if len(parent) > _LONGEST_FOLDER - len("/concord-12345678"):
            continue
        _remove_abandoned(Path(parent))
        try:
            made = tempfile.TemporaryDirectory("", _PREFIX, parent, ignore_cleanup_errors=True)
        except OSError:
            continue
        with made as folder:
            # Under another name at first: no other launcher may find the file without its lock.
            Path(folder, _NEW).touch(mode=0o600)
            lock = _locked(Path(folder, _NEW))
            Path(folder, _NEW).rename(Path(folder, _HELD))
            try:
                yield folder
            finally:
                os.close(lock)
        return
    raise ValueError(
        f"sockets: no folder among {', '.join(filter(None, tried))} takes the sockets of the "
        "network; set TMPDIR to one with a short name, or talk over loopback ports with --port 0"
    )


def hold(folder: str) -> None:
    """Hold a folder of sockets, together with all forked processes, until the last of them ends."""
    with suppress(FileNotFoundError):
        _locked(Path(folder, _HELD))


def _locked(path: Path) -> int:
    """Return a descriptor that shares the lock of a file."""
    lock = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    fcntl.flock(lock, fcntl.LOCK_SH)
    return lock


def _remove_abandoned(parent: Path) -> None:
    """Remove this user's folders of sockets that no process holds."""
    for folder in parent.glob(f"{_PREFIX}*"):
        try:
            # A folder without the file is another program's, or is being made.
            lock = os.open(folder / _HELD, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
        except OSError:
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(lock).st_uid == os.getuid():
                shutil.rmtree(folder, ignore_errors=True)
        except BlockingIOError:
            pass
        finally:
            os.close(lock)


def in_folder(folder: str, names: Sequence[str]) -> dict[str, str]:
    """Return the endpoint of a unix socket for each name."""
    return {name: f"unixsock-stream/{folder}/{name}" for name in names}
