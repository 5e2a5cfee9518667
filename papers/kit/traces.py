"""The numbers behind the figures of a report, as one netCDF file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from concord.results.records.netcdf_file import write_dataset

TRACES = "traces.nc"


def write_traces(
    folder: Path,
    variables: Mapping[str, tuple[Sequence[str], np.ndarray]],
    coordinates: Mapping[str, Sequence[str] | np.ndarray],
) -> None:
    """Write the variables, each with the names of its axes, to `traces.nc` in the folder.

    Args:
        folder: of the report.
        variables: by name, (axes, values).
        coordinates: labels along an axis, by axis.

    Raises:
        NotWritten: the disk does not take it.
    """
    # Only here: its import takes half a second.
    import xarray

    dataset = xarray.Dataset(
        {name: (tuple(axes), values) for name, (axes, values) in variables.items()},
        {axis: list(labels) for axis, labels in coordinates.items()},
    )
    write_dataset(dataset, folder / TRACES)
