"""A data set as a netCDF file, written whole or not at all, and read whole or refused.

HDF5 crashes the process that closes a file of which a full disk has not taken all (h5py 3.16,
HDF5 2.0). So it writes through a file that takes everything, and remembers what the disk did not.
"""

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

from concord.runtime.disk import writing

if TYPE_CHECKING:
    import xarray


class _Patient(io.RawIOBase):
    """A file whose writes never fail: the first one that does is kept as `error`."""

    def __init__(self, path: Path) -> None:
        # Without a buffer, whose last part would fail as it is closed.
        self._file = path.open("w+b", buffering=0)
        self.error: OSError | None = None

    def write(self, data: Any, /) -> int:
        """All of `data`, as far as anybody can tell."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while self.error is None and left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None, /) -> int:
        """Set the length of the file; return it."""
        return self._file.truncate(size) if self.error is None else (size or 0)

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes of the file into the buffer; return their number."""
        return self._file.readinto(buffer)

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """Go on somewhere else."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._file.tell()

    def readable(self) -> bool:
        """HDF5 reads what it has written."""
        return True

    def writable(self) -> bool:
        """It is for writing."""
        return True

    def seekable(self) -> bool:
        """HDF5 writes here and there."""
        return True

    def close(self) -> None:
        """Let the file go."""
        self._file.close()
        super().close()


def write_dataset(
    dataset: "xarray.Dataset", path: Path, encoding: dict[str, dict[str, Any]] | None = None
) -> None:
    """Write a data set; an older file of that name is replaced when the new one is whole.

    Raises:
        NotWritten: the disk does not take it.
    """
    from xarray.backends import H5NetCDFStore

    part = path.with_name(f"{path.name}.part")
    try:
        with writing(path):
            with _Patient(part) as file:
                # `to_netcdf` asks for a lock, and loads all of dask for it where that is installed.
                store = H5NetCDFStore.open(file, mode="w", lock=False)
                try:
                    dataset.dump_to_store(store, encoding=encoding)
                finally:
                    store.close()
                if file.error is not None:
                    raise file.error
            part.replace(path)
    finally:
        # Interrupted: no arrays are better than broken ones.
        part.unlink(missing_ok=True)


def read_dataset(path: Path, names: Iterable[str], remedy: str) -> "xarray.Dataset":
    """Return the data set of a file that has the variables of these names.

    Raises:
        ValueError: the file cannot be read, or lacks a variable; the message ends with `remedy`.
    """
    import xarray

    with _readable(path, remedy):
        dataset = xarray.load_dataset(path, engine="h5netcdf")
    lacking = [name for name in names if name not in dataset.variables]
    if lacking:
        raise ValueError(f"{path}: has no variable {', '.join(lacking)}; {remedy}")
    return dataset


def open_dataset(path: Path, remedy: str) -> "xarray.Dataset":
    """Return the data set of a file; it reads a variable when that is first used.

    Raises:
        ValueError: the file cannot be read; the message ends with `remedy`.
    """
    import xarray

    with _readable(path, remedy):
        return xarray.open_dataset(path, engine="h5netcdf")


@contextmanager
def _readable(path: Path, remedy: str) -> Iterator[None]:
    """Turn the errors of reading a file into one that names it."""
    import h5py

    try:
        # h5netcdf's file, when it cannot be opened, raises once more as Python collects it.
        with h5py.File(path, "r") as file:
            dict(file.attrs)
        yield
    except Exception as error:
        # HDF5, h5py, h5netcdf and xarray each raise errors of their own at a damaged byte.
        raise ValueError(
            f"{path}: cannot be read as netCDF ({_first_line(error)}); {remedy}"
        ) from None


def _first_line(error: Exception) -> str:
    return shorten(str(error) or type(error).__name__, 200, placeholder=" ...")
