"""A data set as a netCDF file, written whole or not at all, and read whole or refused.

HDF5 crashes the process that closes a file of which a full disk has not taken all (h5py 3.16,
HDF5 2.0). So it writes into memory. `Arrays` spares a run xarray, which takes longer to load than
many runs take: with it come pandas, and all of dask where that is installed.
"""

from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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


class Arrays(NamedTuple):
    """The parts of a data set: by name, (dimensions, values[, attributes]), or the values alone
    of a coordinate along its own dimension."""

    variables: Mapping[str, Any]
    coordinates: Mapping[str, Any]
    attributes: Mapping[str, Any]


def arrays_of(dataset: "xarray.Dataset") -> Arrays:
    """The arrays of a data set."""
    variables, coordinates = (
        {str(name): (one.dims, one.values, one.attrs) for name, one in some.items()}
        for some in (dataset.data_vars, dataset.coords)
    )
    return Arrays(variables, coordinates, {str(key): one for key, one in dataset.attrs.items()})


def write_arrays(arrays: Arrays, path: Path, compressed: bool = False) -> None:
    """Write netCDF 4 by the conventions of xarray, which reads the same data set from it; an older
    file of that name is replaced when the new one is whole.

    Raises:
        NotWritten: the disk does not take it.
    """
    # Only here: many programs write no file.
    from h5netcdf import File

    coordinates = {name: _parts(name, one) for name, one in arrays.coordinates.items()}
    variables = {name: _parts(name, one) for name, one in arrays.variables.items()}
    every, buffer = coordinates | variables, BytesIO()
    # A coordinate of another name than its dimension belongs to the variables along that.
    aside = {name: set(one[0]) for name, one in coordinates.items() if one[0] != (name,)}
    free = set(aside)
    with File(buffer, "w") as file:
        file.dimensions = {
            axis: size
            for dimensions, values, _ in every.values()
            for axis, size in zip(dimensions, values.shape, strict=True)
        }
        for name, (dimensions, values, attributes) in every.items():
            beside = [one for one in sorted(aside) if aside[one] <= set(dimensions)]
            if name not in coordinates and beside:
                attributes = {**attributes, "coordinates": " ".join(beside)}
                free -= set(beside)
            _write(file, name, dimensions, values, attributes, compressed and values.ndim > 0)
        file.attrs.update(arrays.attributes)
        if free:
            file.attrs["coordinates"] = " ".join(sorted(free))
    with whole_file(path) as part:
        part.write_bytes(buffer.getbuffer())


def _parts(name: str, told: Any) -> tuple[tuple[str, ...], np.ndarray, dict[str, Any]]:
    """Return dimensions, values and attributes as they stand in a file."""
    dimensions, values, *more = told if isinstance(told, tuple) else (name, told)
    dimensions = (dimensions,) if isinstance(dimensions, str) else tuple(dimensions)
    values, attributes = np.asarray(values), dict(*more)
    if values.dtype == bool:
        return dimensions, values.astype(np.int8), attributes | {"dtype": "bool"}
    return dimensions, values.astype(object) if values.dtype.kind == "U" else values, attributes


def _write(
    file: Any,
    name: str,
    dimensions: tuple[str, ...],
    values: np.ndarray,
    attributes: dict[str, Any],
    compressed: bool,
) -> None:
    from h5py import string_dtype

    dtype = string_dtype() if values.dtype.kind == "O" else values.dtype
    is_filled = values.dtype.kind == "f" and dimensions != (name,)
    variable = file.create_variable(
        name,
        dimensions,
        dtype,
        values,
        fillvalue=values.dtype.type(np.nan) if is_filled else None,
        **({"compression": "gzip", "compression_opts": 4} if compressed else {}),
    )
    variable.attrs.update(attributes)


def write_dataset(dataset: "xarray.Dataset", path: Path, compressed: bool = False) -> None:
    """Write a data set, as `write_arrays` does."""
    write_arrays(arrays_of(dataset), path, compressed)


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
