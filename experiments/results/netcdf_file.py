"""A data set as a netCDF file, whole or not at all.

HDF5 crashes the process that closes a file of which a full disk has not taken all (h5py 3.16,
HDF5 2.0). So it writes through a file that takes everything, and remembers what the disk did not.
"""

import io
from pathlib import Path
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
    part = path.with_name(f"{path.name}.part")
    try:
        with writing(path):
            with _Patient(part) as file:
                dataset.to_netcdf(file, engine="h5netcdf", encoding=encoding)
                if file.error is not None:
                    raise file.error
            part.replace(path)
    finally:
        # Interrupted: no arrays are better than broken ones.
        part.unlink(missing_ok=True)
