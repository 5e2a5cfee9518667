"""Logs in ULog files, as PX4 writes them."""

from pathlib import Path

import numpy as np

from concord.plants.recorded.log_file import LogFile


class ULogFile(LogFile):
    """Fields of the logged messages, `sensor_combined.gyro_rad[2]`, stamped by their `timestamp`.

    The number of an instance other than the first follows the name: `vehicle_imu:1.delta_angle[0]`.
    """

    def __init__(self, file: Path) -> None:
        """Read the file.

        Raises:
            ValueError: the extra `logs` is missing, or the file cannot be read.
        """
        try:
            from pyulog import ULog
        except ImportError:
            raise ValueError(
                f"{file}: ULog needs pyulog, which is not installed; run `make extras`, or "
                "`pip install '.[logs]'` in a checkout of concord"
            ) from None
        try:
            with file.open("rb") as stream:
                messages = ULog(stream).data_list
        except Exception as error:  # its readers of broken files raise what they meet
            raise ValueError(f"{file}: cannot be read as ULog ({error})") from None
        self._messages = {
            message.name + (f":{message.multi_id}" if message.multi_id else ""): message.data
            for message in messages
        }
        self.names = tuple(
            f"{name}.{field}" for name, fields in self._messages.items() for field in fields
        )

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a field."""
        message, _, field = name.partition(".")
        return self._messages[message][field].astype(float)

    def stamps_s(self, name: str) -> np.ndarray:
        """Return the times (n,) of the messages that hold a field."""
        message, _, _ = name.partition(".")
        if "timestamp" not in self._messages[message]:
            raise ValueError(f"{name}: its message {message} has no timestamp")
        return self._messages[message]["timestamp"] / 1e6
