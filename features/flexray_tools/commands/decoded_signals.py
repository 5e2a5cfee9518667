"""`concord flexray decode --signals`: the signals in a log of frames."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from concord.features.flexray_tools.files.xml_document import ClusterFileError
from concord.features.flexray_tools.frame_logs.log_files import FrameLog
from concord.features.flexray_tools.signals.arxml_signals import ARXML_SIGNALS
from concord.features.flexray_tools.signals.coding import DescribedSignals
from concord.features.flexray_tools.signals.described_signals import read_signals
from concord.features.flexray_tools.signals.fibex_signals import FIBEX_SIGNALS
from concord.features.flexray_tools.signals.signal_log import (
    SignalLog,
    signals_of_log,
    write_signals,
)

_HEAD_BYTES = 4096


def read_described_signals(path: Path, cluster: str | None = None) -> DescribedSignals:
    """Return the signals that a FIBEX or AUTOSAR file describes.

    Raises:
        ClusterFileError: naming the file, for one that cannot be read or describes no signal.
    """
    try:
        data = path.read_bytes()
        form = ARXML_SIGNALS if b"<AUTOSAR" in data[:_HEAD_BYTES] else FIBEX_SIGNALS
        return read_signals(form, data, cluster)
    except OSError as error:
        raise ClusterFileError(f"{path}: cannot be read ({error.strerror})") from None
    except ClusterFileError as error:
        raise ClusterFileError(f"{path}: {error}") from None


def print_signals(
    log: FrameLog | None, out: Path | None, description: Path | None, cluster: str | None
) -> None:
    """Write the signals of a log, and print what they are.

    Raises:
        ValueError: an option is missing, or a file cannot be read or written.
    """
    if out is None or description is None:
        given = f"--signals {out}" if description is None else f"--description {description}"
        raise ValueError(f"{given}: give both --signals FILE and --description FILE.xml")
    if log is None:
        raise ValueError(
            f"--signals {out}: signals are read from a log of frames (pcap, BLF, or CSV with the "
            "columns of docs/bus.md); decode --pcap makes one of a waveform"
        )
    described = read_described_signals(description, cluster)
    found = signals_of_log(log, described)
    write_signals(out, found)
    sys.stdout.writelines(f"{line}\n" for line in _lines(found, described, out))


def _lines(found: SignalLog, described: DescribedSignals, out: Path) -> Iterator[str]:
    width = max(len(name) for one in found.series for name in one.names)
    yield f"{'signal':<{width}} {'numbers':>8} {'least':>12} {'most':>12} unit"
    for one in found.series:
        for name, unit, values in zip(one.names, one.units, one.values.T, strict=True):
            there = values[~np.isnan(values)]
            least, most = (f"{f(there):.6g}" if len(there) else "-" for f in (np.min, np.max))
            yield f"{name:<{width}} {len(there):>8} {least:>12} {most:>12} {unit or '1'}"
    for counted, what in (
        (found.invalid, "are not valid"),
        (found.stale, "were not sent anew, as their update bit says"),
        (found.short, "frames had too short a payload"),
    ):
        for name, count in counted.items():
            yield f"{name}: {count} {what}"
    if found.silent:
        yield f"frames that never came: {', '.join(found.silent)}"
    for name, why in described.left_out.items():
        yield f"{name} is left out: {why}"
    yield f"the series are in {out}"
