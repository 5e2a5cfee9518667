"""Readings of a log in place of the noise of an own plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np

from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import named_channels
from concord.plants.own_truth import NodeSensors, OfOwnPlant
from concord.plants.placement import Draws, GeneratorFor
from concord.plants.recorded.channels import (
    ChannelReadings,
    earlier,
    grid_over,
    mean_by_step,
    readings_by_step,
)
from concord.plants.recorded.columns import Column, LogMap, Stamps, map_from_toml, read_channels
from concord.plants.recorded.dataset_files import DatasetFile
from concord.plants.recorded.log_file import LogFile
from concord.plants.recorded.log_files import open_log
from concord.plants.recorded.text_files import text_of

COLUMNS = "columns.toml"
_TIME = "time"
_TRUTH = "truth of "


@dataclass(frozen=True, eq=False)
class OwnReplay(OfOwnPlant):
    """The sensors of an own plant deliver the readings of a log; a run repeats them.

    Attributes:
        plant: that the filters believe in.
        truth: (steps, n), NaN where the log does not know it.
        readings: (steps, nodes, r, d), up to r of one step; NaN for none.
    """

    truth: np.ndarray
    readings: np.ndarray

    @property
    def steps(self) -> int:
        """Number of instants of the log."""
        return len(self.truth)

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return no noise; the log has its own."""
        shape = (steps, *self.readings.shape[1:])
        return Draws(np.zeros(self.plant.states), np.empty((steps, 0)), np.zeros(shape))

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., n), prior mean (..., n) and prior cov (n, n)."""
        prior = self.plant
        mean = np.broadcast_to(prior.prior_mean, noise.shape).copy()
        return np.broadcast_to(self.truth[0], noise.shape), mean, prior.prior_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """States (..., n) that the log knows one step later; NaN after its end."""
        after = self.truth[step + 1] if step + 1 < self.steps else np.nan
        return np.broadcast_to(after, state.shape)

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Readings (..., nodes, r, d) of a step."""
        return self.readings[step] + noise

    def delayed(self, steps: Sequence[Sequence[int]]) -> "OwnReplay":
        """The log with readings of each node and entry so many steps earlier."""
        return replace(self, readings=earlier(self.readings, steps))

    def positions(self, step: int) -> np.ndarray | None:
        """Return the nodes' places (nodes, 2) in m; None where the user named none."""
        return self.plant.places


def replayed(
    plant: OwnPlant,
    nodes: Sequence[NodeSensors | None],
    source: str | Path | Any,
    usual: str | Path | Any = None,
) -> OwnReplay:
    """Return the plant that delivers the readings of a log.

    A channel of a sensor is the series "NAME CHANNEL", also with a dot or a line between both, or
    the one that the columns file gives. A state whose name the log has is its truth.

    Args:
        plant: that the filters believe in.
        nodes: sensors of each node; each channel has a name of its own.
        source: a file, a folder with `columns.toml`, or an `xarray.Dataset`.
        usual: the log that the scenario names itself; where it is such a folder, its columns are
            sought in a file that has no series of these names.

    Raises:
        ValueError: naming file, series and cure, for what is missing or cannot be read.
    """
    channels = _channels_of(nodes)
    truths = {f"{_TRUTH}{name}": unit for name, unit in zip(plant.names, plant.units, strict=True)}
    units = {name: unit for name, unit in channels.values()} | truths
    found = _read(source, units)
    if not found.keys() - truths.keys() and (like := _map_beside(source, usual, units)) is not None:
        found = read_channels(Path(source).parent, like.columns, like)
    read = {name: one for name, one in found.items() if name not in truths and len(one.values)}
    if not read:
        said = source if isinstance(source, str | Path) else f"of type {type(source).__name__}"
        raise ValueError(
            f"readings {said}: none of {', '.join(name for name, _ in channels.values())} is "
            f"there{_there(source)}; name series so, or map them in {COLUMNS}"
        )
    grid = grid_over(read, plant.time_step_s)
    placed = {
        place: readings_by_step(read[name], grid)
        for place, (name, _) in channels.items()
        if name in read
    }
    most = max(one.shape[1] for one in placed.values())
    width = max(entry for _, entry in channels) + 1
    readings = np.full((grid.steps, len(nodes), most, width), np.nan)
    for (node, entry), one in placed.items():
        readings[:, node, : one.shape[1], entry] = one
    truth = np.full((grid.steps, plant.states), np.nan)
    for state, name in enumerate(truths):
        if name in found:
            truth[:, state] = mean_by_step(_within(found[name], grid.instants_s), grid)
    return OwnReplay(plant, truth, readings)


def _channels_of(nodes: Sequence[NodeSensors | None]) -> dict[tuple[int, int], tuple[str, str]]:
    """Name and unit of the channel of each node and entry."""
    found: dict[tuple[int, int], tuple[str, str]] = {}
    owners: dict[str, int] = {}
    for node, sensors in enumerate(nodes):
        each = () if sensors is None else sensors.believed
        pairs = [pair for one in each for pair in named_channels(one)]
        for entry, (name, unit) in enumerate(pairs):
            if name in owners:
                raise ValueError(
                    f"readings: nodes {owners[name]} and {node} both have a channel {name!r}; give "
                    "each sensor a name of its own, and each node its own sensors"
                )
            owners[name] = node
            found[node, entry] = (name, unit)
    return found


def _within(channel: ChannelReadings, instants_s: np.ndarray) -> ChannelReadings:
    half_s = 0.5 * (instants_s[1] - instants_s[0]) if len(instants_s) > 1 else 0.0
    inside = (channel.stamps_s > instants_s[0] - half_s) & (
        channel.stamps_s < instants_s[-1] + half_s
    )
    return ChannelReadings(channel.stamps_s[inside], channel.values[inside])


def _there(source: Any) -> str:
    """The series of a file, in words."""
    if not isinstance(source, str | Path) or Path(source).is_dir():
        return ""
    return f" (there are {', '.join(open_log(Path(source)).names)})"


def _map_beside(source: Any, usual: Any, units: Mapping[str, str]) -> LogMap | None:
    """The columns of the scenario's own folder for another file; None where they are of several
    files, or not there."""
    folders = isinstance(source, str | Path) and isinstance(usual, str | Path)
    if not folders or Path(source).is_dir() or not (Path(usual) / COLUMNS).is_file():
        return None
    own = _map_of(Path(usual), _map_kind(units), units)
    of_files = any(column.file is not None for column in own.columns.values())
    return None if of_files else msgspec.structs.replace(own, file=Path(source).name)


def _map_kind(units: Mapping[str, str]) -> type[LogMap]:
    """The map of columns of channels and true states that have these units, "" for any."""

    class OwnLogMap(LogMap, frozen=True, kw_only=True, forbid_unknown_fields=True):
        si_units: ClassVar[Mapping[str, str]] = units
        channels: dict[str, Column] = msgspec.field(default_factory=dict)
        truth: dict[str, Column] = msgspec.field(default_factory=dict)

        @property
        def columns(self) -> dict[str, Column]:
            """The columns by channel and state."""
            return self.channels | {f"{_TRUTH}{name}": one for name, one in self.truth.items()}

    return OwnLogMap


def _map_of(folder: Path, kind: type[LogMap], units: Mapping[str, str]) -> LogMap:
    columns_file = folder / COLUMNS
    try:
        own = map_from_toml(text_of(columns_file), kind)
    except ValueError as error:
        raise ValueError(f"{columns_file}: {error}") from None
    if strange := own.columns.keys() - units.keys():
        raise ValueError(
            f"{columns_file}: no sensor or state has {', '.join(sorted(strange))}; there are "
            f"{', '.join(units)}"
        )
    return own


def _read(source: Any, units: Mapping[str, str]) -> dict[str, ChannelReadings]:
    """Read the channels and true states that have these units, "" for any."""
    if not isinstance(source, str | Path) and not hasattr(source, "data_vars"):
        raise ValueError(
            f"readings of type {type(source).__name__}: must be a path, or an xarray.Dataset"
        )
    if not isinstance(source, str | Path):
        return _read_file(DatasetFile(source), Path("readings"), units)
    path = Path(source)
    if not path.is_dir():
        return _read_file(open_log(path), path, units)
    own = _map_of(path, _map_kind(units), units)
    return read_channels(path, own.columns, own)


def _read_file(file: LogFile, path: Path, units: Mapping[str, str]) -> dict[str, ChannelReadings]:
    """Read the series of a file that have the names of channels and states."""
    spelled = {_plain(name): name for name in file.names}
    asked = {name: _plain(name.removeprefix(_TRUTH)) for name in units}
    columns = {
        name: Column(column=spelled[plain], unit=file.unit(spelled[plain]) or units[name] or None)
        for name, plain in asked.items()
        if plain in spelled
    }
    time = Stamps(spelled[_TIME], file.unit(spelled[_TIME]) or "s") if _TIME in spelled else None
    default = _map_kind(units)(file=path.name, time=time)
    return read_channels(path.parent, columns, default, {path: file})


def _plain(name: str) -> str:
    """A name in which spaces, dots and lines are alike."""
    return "_".join(name.replace(".", " ").replace("_", " ").split())
