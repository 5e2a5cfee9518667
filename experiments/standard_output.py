"""Standard output that cannot be written: a closed pipe, a full disk."""

import io
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from runtime.disk import NotWritten

BROKEN_PIPE = 128 + signal.SIGPIPE


@contextmanager
def standard_output() -> Iterator[None]:
    """A command that prints; exit code 141 if its reader has gone, as after `| head`.

    Raises:
        NotWritten: a disk does not take it.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except OSError as error:
        if _taken():
            raise
        # The rest of the buffer cannot be written, and Python must not try it again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            sys.exit(BROKEN_PIPE)
        raise NotWritten(Path("standard output"), error) from error


def _taken() -> bool:
    """Return whether standard output is well: the error does not say which file it is about."""
    try:
        os.write(sys.stdout.fileno(), b"\n")
    except io.UnsupportedOperation:
        return True
    except OSError:
        return False
    return True
