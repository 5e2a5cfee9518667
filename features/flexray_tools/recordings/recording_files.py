"""Files of recorded signals: CSV, or VCD by its ending or its first word."""

from pathlib import Path

from concord.features.flexray_tools.recordings.analogue_recording import parse_volts
from concord.features.flexray_tools.recordings.csv_recording import Unit, parse_csv
from concord.features.flexray_tools.recordings.vcd_recording import parse_vcd
from concord.features.flexray_tools.recordings.waveform import RecordedSignals, WaveformError

_MDF = (
    'a measurement of ASAM MDF is read as CSV: pip install asammdf pandas, then `python -c "import '
    "asammdf; [g.to_csv('{1}_%d.csv' % n) for n, g in "
    "enumerate(asammdf.MDF('{0}').iter_groups())]\"`, and name the table of the frames, with its "
    "columns in --columns FILE.toml"
)
CONVERTED = {
    ".mf4": _MDF,
    ".mdf": _MDF,
    ".asc": "a log in ASC is read as BLF: the logging file conversion of CANoe or CANalyzer makes "
    "{1}.blf of {0}; name that",
}
"""Cures for other logs of frames, by the ends of their names: {0} is the file, {1} its stem."""


def read_recording(
    path: Path, unit: Unit | None = None, threshold: float | None = None
) -> RecordedSignals:
    """Read the signals of a file; `unit` is that of the times of a CSV file.

    Samples of an analogue CSV file are high from `threshold` volts on.

    Raises WaveformError if the file cannot be read, or is no recording.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise WaveformError(f"cannot be read ({error.strerror}); name a CSV or VCD file") from None
    if data.startswith(b"PK"):
        raise WaveformError("is a packed session of an analyser; export its signal as VCD or CSV")
    text = data.decode(errors="replace")
    if path.suffix.lower() == ".vcd" or text.lstrip().startswith("$"):
        return parse_vcd(text)
    return parse_csv(text, unit) if threshold is None else parse_volts(text, threshold, unit)
