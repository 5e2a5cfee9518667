"""Reader of recordings in the format of the UTIAS multi-robot data sets (MRCLAM).

Leung, Halpern, Barfoot, Liu: The UTIAS multi-robot cooperative localization and mapping dataset,
International Journal of Robotics Research 30(8), 2011.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Robot(NamedTuple):
    """Log of one robot; times are absolute, in s."""

    truth: np.ndarray  # (t, 4): time, x m, y m, heading rad
    measurements: np.ndarray  # (m, 4): time, barcode, range m, bearing rad
    odometry: np.ndarray  # (u, 3): time, forward velocity m/s, turn rate rad/s


@dataclass(frozen=True, eq=False)
class Recording:
    """A folder of files, read. Robots and landmarks are numbered as subjects."""

    folder: Path
    barcodes: dict[int, int]  # subject -> barcode
    landmarks: np.ndarray  # (l, 5): subject, x m, y m and their standard deviations m
    robots: dict[int, Robot]


def read_recording(folder: str | Path) -> Recording:
    """All files of a recording: as many robots as have a ground truth.

    Raises:
        ValueError: naming file, line and cure, for a missing file, a row that is cut off or is not
            made of numbers, and a ground truth that does not advance in time.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; give the folder of a MRCLAM recording")
    numbers = sorted(
        int(match[1])
        for file in folder.iterdir()
        if (match := re.fullmatch(r"Robot(\d+)_Groundtruth\.dat", file.name))
    )
    if not numbers:
        raise ValueError(
            f"{folder}: no Robot1_Groundtruth.dat, Robot2_Groundtruth.dat, ...; "
            "give the folder of a MRCLAM recording"
        )
    barcodes = _table(folder / "Barcodes.dat", 2)
    return Recording(
        folder=folder,
        barcodes={int(subject): int(barcode) for subject, barcode in barcodes},
        landmarks=_table(folder / "Landmark_Groundtruth.dat", 5),
        robots={number: _robot(folder, number) for number in numbers},
    )


def _robot(folder: Path, number: int) -> Robot:
    truth_file = folder / f"Robot{number}_Groundtruth.dat"
    truth = _table(truth_file, 4)
    if len(truth) < 2:
        raise ValueError(f"{truth_file}: {len(truth)} rows, but 2 are needed; fetch the file again")
    for row in np.flatnonzero(np.diff(truth[:, 0]) <= 0):
        raise ValueError(
            f"{truth_file}: time {truth[row + 1, 0]:.3f} s does not follow {truth[row, 0]:.3f} s; "
            "sort the rows by time and drop repeated ones"
        )
    return Robot(
        truth=truth,
        measurements=_table(folder / f"Robot{number}_Measurement.dat", 4),
        odometry=_table(folder / f"Robot{number}_Odometry.dat", 3),
    )


def _table(file: Path, columns: int) -> np.ndarray:
    """Return the numbers of a file: (rows, columns); `#` begins a comment line."""
    if not file.is_file():
        raise ValueError(f"{file}: no such file; a MRCLAM recording has one, fetch it again")
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    rows = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        return np.empty((0, columns))
    try:
        table = np.loadtxt(rows, ndmin=2, comments=None)
    except ValueError:
        table = np.empty((0, 0))
    if table.shape[1] != columns or not np.isfinite(table).all():
        raise _complaint(file, lines, columns)
    return table


def _complaint(file: Path, lines: list[str], columns: int) -> ValueError:
    """Return the error of the first bad line; called only after fast reading has failed."""
    for number, line in enumerate(lines, start=1):
        fields = [] if line.lstrip().startswith("#") else line.split()
        if fields and len(fields) != columns:
            return ValueError(
                f"{file}:{number}: {len(fields)} numbers, but a row has {columns} (cut off?); "
                "fetch the file again or remove the row"
            )
        for field in fields:
            if not _is_number(field):
                return ValueError(
                    f"{file}:{number}: {field!r} is not a finite number; "
                    "fetch the file again or remove the row"
                )
    return ValueError(f"{file}: not a table of {columns} numbers per row; fetch the file again")


def _is_number(field: str) -> bool:
    try:
        return bool(np.isfinite(float(field)))
    except ValueError:
        return False
