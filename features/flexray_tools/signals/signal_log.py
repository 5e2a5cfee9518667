"""The signals in a log of frames, as series with stamps, and the files that hold these."""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.features.flexray_tools.frame_logs.frames import NULL, FrameBlock
from concord.features.flexray_tools.frame_logs.log_files import FrameLog
from concord.features.flexray_tools.signals.coding import (
    DescribedSignals,
    FrameSignals,
    PlacedSignal,
)

# A frame that is sent on both channels comes twice within so short a time.
_BOTH_CHANNELS_NS = 100_000
_TIME = "time"


class FrameSeries(NamedTuple):
    """The signals of one frame in a log: its name, the stamps (n,) of the log in s, the names and
    units of its signals, and their values (n, signals), NaN for none."""

    name: str
    time_s: NDArray[np.float64]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: NDArray[np.float64]


class SignalLog(NamedTuple):
    """The series of each frame of a log that came; `silent` are the frames that never did.

    By signal, how many numbers are `invalid`, or `stale`, as they were not sent anew; by frame, how
    many had too `short` a payload.
    """

    series: tuple[FrameSeries, ...]
    invalid: dict[str, int]
    stale: dict[str, int]
    short: dict[str, int]
    silent: tuple[str, ...]


def signals_of_log(log: FrameLog, described: DescribedSignals) -> SignalLog:
    """Return the signals in the sound frames of a log; null frames have none.

    Raises:
        ValueError: the log cannot be read, or none of the frames is there.
    """
    invalid, stale, short = Counter[str](), Counter[str](), Counter[str]()
    # A frame that is sent in several slots is one.
    names = _unique_names(described)
    found = {key: list[tuple[NDArray[np.float64], NDArray[np.float64]]]() for key in names}
    for block in log.blocks():
        usable = block.of(block.sure & (block.flags & NULL == 0))
        for frame in described.frames:
            key = frame.name, frame.signals
            rows = _rows_of(usable, frame, short)
            if len(rows.start):
                values = _values(rows, frame, names[key], invalid, stale)
                found[key].append((rows.time_ns / 1e9, values))
    series = tuple(_series(key, names[key], parts) for key, parts in found.items() if parts)
    silent = tuple(key[0] for key, parts in found.items() if not parts and key[0] not in short)
    if not series:
        ids = ", ".join(str(one.frame_id) for one in described.frames[:9])
        cut = f"; {sum(short.values())} of them have too short a payload" if short else ""
        raise ValueError(
            f"{log.path}: none of the frames with signals came (IDs {ids}){cut}; give the "
            "description of this bus"
        )
    return SignalLog(series, dict(invalid), dict(stale), dict(short), silent)


_Key = tuple[str, tuple[PlacedSignal, ...]]


def _series(
    key: _Key, names: tuple[str, ...], parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]]
) -> FrameSeries:
    """The series of a frame, in the order of its stamps."""
    time_s = np.concatenate([times for times, _ in parts])
    order = np.argsort(time_s, kind="stable")
    return FrameSeries(
        key[0],
        time_s[order],
        names,
        tuple(one.coding.unit for one in key[1]),
        np.concatenate([values for _, values in parts])[order],
    )


def _rows_of(block: FrameBlock, frame: FrameSignals, short: Counter[str]) -> FrameBlock:
    """The frames of a block that are this one, once where both channels carry it."""
    chosen = (block.frame_id == frame.frame_id) & (
        block.cycle % frame.repetition == frame.base_cycle % frame.repetition
    )
    chosen &= np.isin(block.channel, ["AB".index(letter) for letter in frame.channels])
    rows = block.of(np.flatnonzero(chosen))
    if len(frame.channels) > 1 and len(rows.start):
        rows = rows.of(np.argsort(rows.time_ns, kind="stable"))
        again = np.diff(rows.time_ns) < _BOTH_CHANNELS_NS
        again &= (np.diff(rows.cycle.astype(int)) == 0) & (np.diff(rows.channel.astype(int)) != 0)
        rows = rows.of(np.concatenate(([True], ~again)))
    fits = rows.length >= max(one.payload_bytes for one in frame.signals)
    if not fits.all():
        short[frame.name] += int((~fits).sum())
    return rows.of(fits)


def _values(
    rows: FrameBlock,
    frame: FrameSignals,
    names: tuple[str, ...],
    invalid: Counter[str],
    stale: Counter[str],
) -> NDArray[np.float64]:
    """Numbers (n, signals) of the signals of a frame."""
    size = max(one.payload_bytes for one in frame.signals)
    data = np.frombuffer(rows.data, dtype=np.uint8)
    payloads = data[rows.start[:, None] + np.arange(size)]
    values = np.empty((len(payloads), len(frame.signals)))
    for place, (name, one) in enumerate(zip(names, frame.signals, strict=True)):
        numbers, is_new = one.values(payloads), one.is_new(payloads)
        for counted, lacking in ((stale, ~is_new), (invalid, is_new & np.isnan(numbers))):
            if lacking.any():
                counted[name] += int(lacking.sum())
        values[:, place] = np.where(is_new, numbers, np.nan)
    return values


def _unique_names(described: DescribedSignals) -> dict[_Key, tuple[str, ...]]:
    """The names of the signals of each frame; one that is there again begins with its frame, and
    ends with a number where that is there again too.

    Letters, digits, points and lines alone: names of columns, variables and topics.
    """
    frames = dict.fromkeys((frame.name, frame.signals) for frame in described.frames)
    used = Counter(_plain(one.name) for _, signals in frames for one in signals)
    taken = set[str]()

    def named(frame: str, signal: str) -> str:
        own = f"{_plain(frame)}_{signal}"
        is_clear = used[signal] == 1 and not signal.lower().startswith(_TIME)
        wanted = signal if is_clear else own
        several = (f"{own}_{number}" for number in itertools.count(2))
        name = next(one for one in itertools.chain((wanted,), several) if one not in taken)
        taken.add(name)
        return name

    return {
        (frame, signals): tuple(named(frame, _plain(one.name)) for one in signals)
        for frame, signals in frames
    }


def _plain(name: str) -> str:
    return re.sub(r"[^\w.\[\]-]+", "_", name)


def write_signals(path: Path, log: SignalLog) -> None:
    """Write the series to a file: CSV, netCDF (.nc) or MCAP of ROS 2 (.mcap), as a columns file
    takes them.

    Raises:
        ValueError: the name has another ending, or the file exists or cannot be written.
    """
    writers: dict[str, Callable[[Path, SignalLog], None]] = {
        ".csv": _write_csv, ".nc": _write_netcdf, ".mcap": _write_mcap,
    }  # fmt: skip
    write = writers.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"--signals {path}: must end in .csv, .nc or .mcap")
    if path.exists():
        raise ValueError(f"--signals {path}: exists; name another file")
    if not path.parent.is_dir():
        raise ValueError(f"--signals {path}: there is no folder {path.parent}; make it first")
    # A file under another name until it is complete.
    unfinished = path.with_name(f".{path.name}.unfinished")
    try:
        write(unfinished, log)
        unfinished.rename(path)
    except (OSError, RuntimeError) as error:
        why = str(error).partition("\n")[0][:200]
        raise ValueError(f"--signals {path}: cannot be written ({why})") from None
    finally:
        unfinished.unlink(missing_ok=True)


def _write_csv(path: Path, log: SignalLog) -> None:
    """A line for each frame, in the order of the stamps; signals of other frames are empty."""
    columns = [(place, one) for place, one in enumerate(log.series) for _ in one.names]
    names = [name for one in log.series for name in one.names]
    units = [unit for one in log.series for unit in one.units]
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow([_TIME, *names])
        if any(units):
            rows.writerow(["s", *units])
        for time_s, place, values in _in_order(log):
            own = iter(values)
            cells = [_text(next(own)) if number == place else "" for number, _ in columns]
            rows.writerow([f"{time_s:.9f}", *cells])


def _in_order(log: SignalLog) -> Iterator[tuple[float, int, list[float]]]:
    times = np.concatenate([one.time_s for one in log.series])
    frames = np.concatenate([np.full(len(one.time_s), n) for n, one in enumerate(log.series)])
    rows = np.concatenate([np.arange(len(one.time_s)) for one in log.series])
    for entry in np.argsort(times, kind="stable"):
        place = int(frames[entry])
        yield float(times[entry]), place, log.series[place].values[rows[entry]].tolist()


def _text(value: float) -> str:
    return "" if np.isnan(value) else repr(value)


def _write_netcdf(path: Path, log: SignalLog) -> None:
    import xarray  # here, so that other commands do not load it

    variables, times = {}, {}
    for one in log.series:
        dimension = f"{_TIME}_{_plain(one.name)}"
        times[dimension] = ((dimension,), one.time_s, {"units": "s"})
        for name, unit, values in zip(one.names, one.units, one.values.T, strict=True):
            variables[name] = ((dimension,), values, {"units": unit})
    xarray.Dataset(variables, coords=times).to_netcdf(path, engine="h5netcdf")


def _write_mcap(path: Path, log: SignalLog) -> None:
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise ValueError(
            f"--signals {path}: MCAP needs mcap-ros2-support, which is not installed; run `make "
            "extras`, or `pip install '.[logs]'` in a checkout of concord"
        ) from None
    if min(one.time_s[0] for one in log.series) < 0:
        raise ValueError("--signals: MCAP has no stamps before 0; write .csv or .nc")
    with path.open("wb") as file:
        writer = Writer(file)
        number = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        for time_s, place, values in _in_order(log):
            stamp_ns = round(time_s * 1e9)
            for name, value in zip(log.series[place].names, values, strict=True):
                if not np.isnan(value):
                    writer.write_message(f"/{name}", number, {"data": value}, stamp_ns, stamp_ns)
        writer.finish()
