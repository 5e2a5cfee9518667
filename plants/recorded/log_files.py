"""Files of logs by the ends of their names."""

from collections.abc import Callable, Mapping
from pathlib import Path

from concord.plants.recorded.dataset_files import DatasetFile
from concord.plants.recorded.log_file import LogFile
from concord.plants.recorded.mcap_files import McapFile
from concord.plants.recorded.text_files import CsvFile
from concord.plants.recorded.ulog_files import ULogFile

READERS: Mapping[str, Callable[[Path], LogFile]] = {
    ".csv": CsvFile,
    ".nc": DatasetFile,
    ".mcap": McapFile,
    ".ulg": ULogFile,
}
"""Reader of a file by the end of its name."""
_CONVERTED = {
    ".bag": "a bag of ROS 1 is read as MCAP: pip install rosbags, then "
    "`rosbags-convert --src {0} --dst {1} --dst-storage mcap`, and name the .mcap in {1}",
    ".mat": 'a file of MATLAB is read as CSV: `python -c "import pandas, scipy.io; '
    "log = scipy.io.loadmat('{0}', squeeze_me=True); "
    "pandas.DataFrame({{k: v for k, v in log.items() if getattr(v, 'ndim', 0) == 1}})"
    ".to_csv('{1}.csv', index=False)\"`, and name {1}.csv",
}
"""Cures for other logs, by the ends of their names: {0} is the file, {1} its name less that."""


def open_log(file: Path) -> LogFile:
    """Return the series of a file.

    Raises:
        ValueError: naming the file, for one that cannot be read or ends in no known way.
    """
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        known = f"a log is read from files that end in {', '.join(READERS)}"
        cure = _CONVERTED.get(file.suffix.lower(), known)
        raise ValueError(f"{file}: {cure.format(file, file.with_suffix(''))}")
    if not file.exists():
        raise ValueError(f"{file}: is not there; name a log that is")
    return reader(file)
