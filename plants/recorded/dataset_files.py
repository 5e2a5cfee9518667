"""Logs in netCDF files, as xarray writes them."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from concord.plants.recorded.log_file import LogFile
from concord.plants.recorded.netcdf import open_netcdf
from concord.plants.recorded.units import unit_of

if TYPE_CHECKING:
    import xarray

_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class DatasetFile(LogFile):
    """Variables of one dimension each; a coordinate of that dimension stamps them.

    The coordinate holds dates (`datetime64`), or numbers with the attribute `units`: s, ms, us or
    ns. Dates count from 1970, exact to 0.3 us.
    """

    def __init__(self, file: "Path | xarray.Dataset") -> None:
        """Read the file, or take a data set.

        Raises:
            ValueError: it cannot be read.
        """
        import xarray  # here, so that a node process never loads it

        if isinstance(file, xarray.Dataset):
            self._variables = file.variables
        else:
            self._variables = open_netcdf(file, whole=True, decode_timedelta=False).variables
        self.names = tuple(
            str(name)
            for name, variable in self._variables.items()
            if variable.ndim == 1 and variable.dtype.kind in "fiubM"
        )

    @property
    def stamping(self) -> tuple[str, ...]:
        """The coordinates that stamp others."""
        return tuple({str(one.dims[0]): None for one in self._variables.values() if one.ndim == 1})

    def unit(self, name: str) -> str | None:
        """Return the unit in the attributes of a variable, s for dates, None for neither."""
        variable = self._variables[name]
        if variable.dtype.kind == "M":
            return "s"
        unit = variable.attrs.get("units")
        return unit_of(unit) if isinstance(unit, str) and unit_of(unit) not in ("", "1") else None

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a variable; dates in seconds."""
        values = self._variables[name].values
        if values.dtype.kind != "M":
            return values.astype(float)
        since_s = (values - np.datetime64(0, "s")) / np.timedelta64(1, "s")
        return np.where(np.isnat(values), np.nan, since_s)

    def stamps_s(self, name: str) -> np.ndarray | None:
        """Return the coordinate (n,) of a variable, or None where it has no known unit of time."""
        (dimension,) = self._variables[name].dims
        if dimension not in self.names:
            return None
        coordinate = self._variables[dimension]
        dated = coordinate.dtype.kind == "M"
        factor = 1.0 if dated else _TIME_UNITS.get(coordinate.attrs.get("units", ""))
        return None if factor is None else factor * self.series(str(dimension))
