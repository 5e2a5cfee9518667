"""Files of logs: the small ones of `examples/own_log.py`, read back, and broken ones."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from concord.features.vehicle.plant.drive_log import read_log
from concord.plants.recorded.channels import ChannelReadings
from concord.plants.recorded.log_files import open_log

ROOT = Path(__file__).resolve().parent.parent.parent
EXAMPLE = runpy.run_path(str(ROOT / "examples" / "own_log.py"))
PACKAGES = {"nc": "xarray", "mcap": "mcap_ros2", "ulg": "pyulog"}
SENSORS = {
    "yaw_rate": ("inertial", 0),
    "lateral_acceleration": ("inertial", 1),
    "longitudinal_acceleration": ("inertial", 2),
    "rear_left_wheel": ("wheels", 0),
    "rear_right_wheel": ("wheels", 1),
    "steering": ("steering", 0),
    "side_slip": ("side_slip", 0),
}
SHORT_S = 0.3


def folder_of(folder: Path, kind: str) -> Path:
    pytest.importorskip(PACKAGES[kind])
    columns = EXAMPLE["WRITERS"][kind](folder, EXAMPLE["signals"](SHORT_S))
    (folder / "columns.toml").write_text(columns)
    (folder / "car.toml").write_text(EXAMPLE["CAR"])
    return folder


@pytest.mark.parametrize("kind", PACKAGES)
def test_each_kind_of_file_is_read_as_it_was_written(kind: str, tmp_path: Path):
    logged = EXAMPLE["signals"](SHORT_S)
    channels = read_log(folder_of(tmp_path, kind)).channels
    assert set(channels) == set(SENSORS)
    start_s = np.round(channels["yaw_rate"].stamps_s[0] - logged["inertial"][0][0])
    assert start_s == (0 if kind == "ulg" else 1_780_315_200)
    for name, (sensor, place) in SENSORS.items():
        stamps_s, values = logged[sensor]
        np.testing.assert_array_equal(channels[name].values, values[:, place])
        # Seconds since 1970 are exact to a fourth of a microsecond in a float.
        np.testing.assert_allclose(channels[name].stamps_s - start_s, stamps_s, rtol=0, atol=3e-7)


@pytest.mark.parametrize("kind", PACKAGES)
def test_a_broken_file_and_a_missing_series_are_named(kind: str, tmp_path: Path):
    folder = folder_of(tmp_path, kind)
    with pytest.raises(ValueError, match=rf"drive\.{kind}: no column 'speed' for speed; there are"):
        columns = (folder / "columns.toml").read_text()
        (folder / "columns.toml").write_text(columns + 'speed = {column = "speed", unit = "m/s"}')
        read_log(folder)
    (folder / f"drive.{kind}").write_bytes(b"not a log")
    with pytest.raises(ValueError, match=rf"drive\.{kind}: cannot be read as"):
        read_log(folder)
    with pytest.raises(ValueError, match=rf"other\.{kind}: is not there; name a log"):
        open_log(folder / f"other.{kind}")


@pytest.mark.parametrize(("kind", "package"), [("mcap", "mcap_ros2.decoder"), ("ulg", "pyulog")])
def test_a_missing_package_is_named_with_its_cure(kind, package, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / f"drive.{kind}").touch()
    with pytest.raises(ValueError, match="which is not installed; run `make extras`"):
        open_log(tmp_path / f"drive.{kind}")


def netcdf(folder: Path, time: np.ndarray, attributes: dict, columns: str) -> ChannelReadings:
    log = xr.Dataset({name: ("t", np.arange(3.0)) for name in ("r", "d", "v")})
    log.assign_coords(t=("t", time, attributes)).to_netcdf(folder / "drive.nc", engine="h5netcdf")
    (folder / "columns.toml").write_text(
        'file = "drive.nc"\n' + columns + 'yaw_rate = { column = "r", unit = "rad/s" }\n'
        'steering = { column = "d", unit = "rad" }\nspeed = { column = "v", unit = "m/s" }\n'
    )
    (folder / "car.toml").write_text(EXAMPLE["CAR"])
    return read_log(folder).channels["yaw_rate"]


def test_a_coordinate_of_numbers_stamps_by_its_unit_or_by_the_map(tmp_path: Path):
    time, expected = np.array([0.0, 10.0, 25.0]), [0.0, 0.01, 0.025]
    told = netcdf(tmp_path, time, {"units": "ms"}, "")
    np.testing.assert_allclose(told.stamps_s, expected)
    mapped = netcdf(tmp_path, time, {}, 'time = { column = "t", unit = "ms" }\n')
    np.testing.assert_allclose(mapped.stamps_s, expected)
    with pytest.raises(ValueError, match="no time for yaw_rate; name the column of its stamps"):
        netcdf(tmp_path, time, {}, "")


def test_a_stamp_of_a_ulog_message_may_be_another_field(tmp_path: Path):
    """Its own `timestamp` is a series too, and here it is read by the map with a unit."""
    folder = folder_of(tmp_path, "ulg")
    columns = (folder / "columns.toml").read_text()
    named = columns.replace(
        '"steering.value[0]",',
        '"steering.value[0]", time = { column = "steering.timestamp", unit = "us", offset = 0.1 },',
    )
    assert named != columns
    expected = read_log(folder).channels["steering"].stamps_s
    (folder / "columns.toml").write_text(named)
    np.testing.assert_allclose(read_log(folder).channels["steering"].stamps_s, 0.1 + expected)
