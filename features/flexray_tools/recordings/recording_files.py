"""Files of recorded signals: CSV, or VCD by its ending or its first word."""

from pathlib import Path

from concord.features.flexray_tools.recordings.csv_recording import Unit, parse_csv
from concord.features.flexray_tools.recordings.vcd_recording import parse_vcd
from concord.features.flexray_tools.recordings.waveform import RecordedSignals, WaveformError


def read_recording(path: Path, unit: Unit | None = None) -> RecordedSignals:
    """Read the signals of a file; `unit` is that of the times of a CSV file.

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
    return parse_csv(text, unit)
