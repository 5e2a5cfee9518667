"""A data set as a netCDF file, written whole or not at all, and read whole or refused.

HDF5 crashes the process that closes a file of which a full disk has not taken all (h5py 3.16,
HDF5 2.0). So it writes into memory.
"""

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from concord.disk import whole_file
from concord.scenarios.catalogue import definition_of
from concord.scenarios.setup import Setup

RECORDING, ARRAYS, DESCRIPTION, CAPTURE = "run.mcap", "run.nc", "run.json", "bus.pcap"


def state_coordinates(setup: Setup, steps: int) -> dict[str, Any]:
    """Return the coordinates of steps and of the plant's states."""
    plant = definition_of(setup.scenario).plant(setup.scenario)
    return {
        "step": np.arange(steps),
        "time": ("step", np.arange(steps) * setup.time_step_s, {"units": "s"}),
        "state": list(plant.state_names),
        "state_unit": ("state", list(plant.state_units)),
    }


if TYPE_CHECKING:
    import xarray


def write_dataset(
    dataset: "xarray.Dataset", path: Path, encoding: dict[str, dict[str, Any]] | None = None
) -> None:
    """Write a data set; an older file of that name is replaced when the new one is whole.

    Raises:
        NotWritten: the disk does not take it.
    """
    from xarray.backends import H5NetCDFStore

    buffer = BytesIO()
    # `to_netcdf` asks for a lock, and loads all of dask for it where that is installed.
    store = H5NetCDFStore.open(buffer, mode="w", lock=False)
    try:
        dataset.dump_to_store(store, encoding=encoding)
    finally:
        store.close()
    with whole_file(path) as part:
        part.write_bytes(buffer.getbuffer())


def read_dataset(path: Path, names: Iterable[str], remedy: str) -> "xarray.Dataset":
    """Return the data set of a file that has the variables of these names.

    Raises:
        ValueError: the file cannot be read, or lacks a variable; the message ends with `remedy`.
    """
    dataset = _opened(path, remedy, whole=True)
    lacking = [name for name in names if name not in dataset.variables]
    if lacking:
        raise ValueError(f"{path}: has no variable {', '.join(lacking)}; {remedy}")
    return dataset


def open_dataset(path: Path, remedy: str) -> "xarray.Dataset":
    """Return the data set of a file; it reads a variable when that is first used.

    Raises:
        ValueError: the file cannot be read; the message ends with `remedy`.
    """
    return _opened(path, remedy, whole=False)


def _opened(path: Path, remedy: str, whole: bool) -> "xarray.Dataset":
    # Only here: most programs write such files, and read none.
    from concord.plants.recorded.netcdf import open_netcdf

    try:
        return open_netcdf(path, whole)
    except ValueError as error:
        raise ValueError(f"{error}; {remedy}") from None
