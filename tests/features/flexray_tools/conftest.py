"""Recorded data of the bus; tests that want it skip where it is not beside the checkout."""

from pathlib import Path

import pytest

from concord.features.flexray_tools.recordings.csv_recording import parse_csv
from concord.features.flexray_tools.recordings.decoder import Decoding, decode_waveform
from concord.features.flexray_tools.recordings.waveform import Waveform


def _file(shared_data: Path, name: str) -> Path:
    path = shared_data / name
    if not path.exists():
        pytest.skip(f"needs ../shared/data/{name}")
    return path


@pytest.fixture(scope="session")
def capture(shared_data: Path) -> Waveform:
    """Eight cycles of a real car's bus."""
    file = _file(shared_data, "flexray_capture/audi_cycles_28_35.csv")
    return parse_csv(file.read_text()).signal()


@pytest.fixture(scope="session")
def audi(capture: Waveform) -> Decoding:
    """The frames in them."""
    return decode_waveform(capture)


@pytest.fixture(scope="session")
def sample_fibex(shared_data: Path) -> str:
    """A published FIBEX cluster description."""
    return _file(shared_data, "fibex/fibextest2.xml").read_text(encoding="utf-8")
