"""Data sets of netCDF files, read only where the HDF5 library survives it."""

import faulthandler
import os
import resource
import signal
import warnings
from contextlib import suppress
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import h5py
    import xarray

# A file may claim arrays that it does not hold; compressed ones are seldom a hundredth.
_MOST_BYTES, _MOST_EXPANDED = 100_000_000, 1000
_WALK_S, _WALK_BYTES_PER_S, _WALK_BYTES = 1, 10_000_000, 300_000_000
"""Limits of a walk: processor time, more for a large file, and memory. 100 MB take 0.1 s."""
_READ_WHOLE = 1_000_000
_REFUSED = (OSError, ValueError, TypeError, RuntimeError, KeyError)
"""Errors of h5py at a damaged byte."""


def open_netcdf(path: Path, whole: bool, **options: Any) -> "xarray.Dataset":
    """Return the data set of a file, `whole` or to be read as its variables are used.

    Raises:
        ValueError: the file cannot be read; the message has no cure.
    """
    import xarray

    try:
        _check_survival(path)
        opened = xarray.open_dataset(path, engine="h5netcdf", **options)
        if not whole:
            return opened
        with opened:
            if opened.nbytes > max(_MOST_BYTES, _MOST_EXPANDED * path.stat().st_size):
                raise ValueError(f"it claims {opened.nbytes} bytes")
            return opened.load()
    except Exception as error:
        # HDF5, h5py, h5netcdf and xarray each raise errors of their own at a damaged byte.
        why = shorten(str(error) or type(error).__name__, 200, placeholder=" ...")
        raise ValueError(f"{path}: cannot be read as netCDF ({why})") from None


def _check_survival(path: Path) -> None:
    """Walk through a file in a process of its own, since HDF5 ends the process on some damages.

    The child calls HDF5 alone and leaves without cleaning up. So a thread of the parent cannot
    stop it: h5py frees its lock at a fork.

    Raises:
        ValueError: a signal ended the walk, or it took too much time or memory.
        OSError: there is no such file, or HDF5 refuses to open it.
    """
    import h5py  # before the fork, which then takes milliseconds

    size = path.stat().st_size
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python's, of threads
        child = os.fork()
    if child == 0:
        try:
            _limit(_WALK_S + size // _WALK_BYTES_PER_S, _WALK_BYTES + 4 * size)
            with h5py.File(path, "r") as file:
                _walk(file)
        except MemoryError:
            os._exit(1)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    if status:
        raise ValueError("it is damaged: the HDF5 library ends, or never does, as it reads it")
    # h5netcdf's file, when it cannot be opened, raises once more as Python collects it.
    with h5py.File(path, "r") as file:
        dict(file.attrs)


def _limit(seconds: int, memory: int) -> None:
    """Keep this process within processor time, memory and silence."""
    faulthandler.disable()
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(60 * seconds)
    most = {resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: seconds}
    if (pages := Path("/proc/self/statm")).is_file():
        used = int(pages.read_text().split()[0]) * resource.getpagesize()
        most[resource.RLIMIT_AS] = used + memory
    for what, limit in most.items():
        hard = resource.getrlimit(what)[1]
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (limit, limit))


def _walk(file: "h5py.File") -> None:
    """Read all attributes, and each array: a large one at its ends and in the list of chunks."""
    import h5py

    def visit(_: str, node: "h5py.Group | h5py.Dataset") -> None:
        for attribute in node.attrs:
            with suppress(*_REFUSED):
                node.attrs[attribute]
        with suppress(*_REFUSED):
            if not isinstance(node, h5py.Dataset):
                pass
            elif node.nbytes <= _READ_WHOLE or node.dtype.hasobject:
                node[()]
            else:
                node[(0,) * node.ndim]
                node[tuple(length - 1 for length in node.shape)]
                if node.chunks:
                    node.id.chunk_iter(lambda _: None)

    visit("/", file)
    file.visititems(visit)
