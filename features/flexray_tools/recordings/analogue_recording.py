"""Analogue recordings as CSV: volts that a threshold makes levels of, as PulseView exports them.

Without a column of times, a comment has the sampling rate: `; Samplerate: 100 MHz`.
"""

import re
from collections.abc import Sequence

import numpy as np

from concord.features.flexray_tools.recordings.csv_recording import (
    NANOSECONDS,
    Unit,
    csv_heading,
    data_lines,
)
from concord.features.flexray_tools.recordings.waveform import (
    RecordedSignals,
    WaveformError,
    from_samples,
)

_RATE = re.compile(r"sample\s?rate\W+([\d.]+)\s*([kMG]?)(?:Hz|S/s)", re.IGNORECASE)
_PREFIX = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}


def parse_volts(text: str, threshold: float, unit: Unit | None = None) -> RecordedSignals:
    """Read CSV text of volts; samples of at least `threshold` are high.

    Raises:
        WaveformError: the lines are no numbers, or neither a column nor a comment tells the time.
    """
    heading, lines = csv_heading(data_lines(text))
    rate = _RATE.search(text)
    rows = [_numbers(line) for line in lines]
    columns = max((len(row) for row in rows if row), default=0)
    kept = [row for row in rows if row and len(row) == columns]
    if not kept or 2 * len(kept) < len(rows):
        raise WaveformError(
            f"{len(rows) - len(kept)} of {len(rows)} lines are no volts; export the analogue "
            "signal as CSV"
        )
    samples = np.array(kept)
    if heading.names:
        times_ns = samples[:, heading.time] * NANOSECONDS[unit or heading.unit or "s"]
        columns_of = [n for n in range(columns) if n != heading.time]
    elif rate is not None:
        times_ns = np.arange(len(samples)) * 1e9 / (float(rate[1]) * _PREFIX[rate[2].lower()])
        columns_of = list(range(columns))
    else:
        raise WaveformError(
            "the samples have neither a column of times nor a comment with their rate; add a line "
            "such as '; Samplerate: 100 MHz', or a heading: time_us,volts"
        )
    return RecordedSignals(
        {
            heading.names[n] if n < len(heading.names) else str(n): from_samples(
                np.round(times_ns).astype(np.int64), samples[:, n] >= threshold
            )
            for n in columns_of
        },
        len(rows) - len(kept),
    )


def _numbers(line: str) -> Sequence[float]:
    try:
        return [float(field) for field in line.replace(";", ",").replace("\t", ",").split(",")]
    except ValueError:
        return ()
