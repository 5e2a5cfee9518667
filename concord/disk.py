"""Files that a disk does not take: it is full, a quota or a limit is reached, or it is gone."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class RunFailed(Exception):
    """A failure whose message the command line prints before it ends with exit code 1."""


class NotWritten(RunFailed):
    """A file could not be written to its end; the message names it, and why."""

    def __init__(self, path: Path, error: OSError) -> None:
        # HDF5 puts a page of its own words behind the number.
        why = os.strerror(error.errno) if error.errno else str(error)
        super().__init__(
            f"{path} cannot be written ({why}); make room, or name a folder on another disk"
        )


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """A writer of files that names the file where it fails.

    Raises:
        NotWritten: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise NotWritten(path, error) from error


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path to write a file at, which takes the place of `path` once it is whole.

    Raises:
        NotWritten: it cannot be written.
    """
    # Several shards may write to one folder.
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with writing(path):
            yield unfinished
            unfinished.replace(path)
    finally:
        # Interrupted: no file is better than a broken one.
        unfinished.unlink(missing_ok=True)
