"""Logged drives: what is read is what was written, in SI, and mistakes are named."""

from pathlib import Path

import numpy as np
import pytest

from concord.plants.vehicle.drive import Drive
from concord.plants.vehicle.drive_log import (
    columns_from_toml,
    read_drive,
    read_folder,
    write_drive,
)
from concord.plants.vehicle.parameters import BMW_320I

MAP = """
time = { column = "t", unit = "ms" }
yaw_rate = { column = "yaw", unit = "deg/s", scale = -1.0 }
steering_wheel = { column = "wheel angle", unit = "deg" }
rear_left_wheel = { column = "rl", unit = "km/h" }
rear_right_wheel = { column = "rr", unit = "km/h" }
lateral_acceleration = { column = "ay", unit = "g", offset = 0.5 }
"""
HEAD = "t,yaw,wheel angle,rl,rr,ay,comment\n"


def log(tmp_path: Path, rows: str, head: str = HEAD) -> Path:
    file = tmp_path / "drive.csv"
    file.write_text(head + rows)
    return file


def read(tmp_path: Path, rows: str, ratio: float = 1.0) -> Drive:
    return read_drive(log(tmp_path, rows), columns_from_toml(MAP), ratio)


def random_drive() -> Drive:
    generator = np.random.default_rng(1)
    values = {name: generator.standard_normal(20) for name in Drive._fields[1:]}
    values["wheel_speed_m_s"] = generator.standard_normal((20, 4))
    values["side_slip_rad"][5] = np.nan
    return Drive(0.02, **values)._replace(heading_rad=np.full(20, np.nan))


def test_a_drive_survives_its_folder(tmp_path: Path):
    drive = random_drive()
    write_drive(tmp_path, drive, BMW_320I)
    again, car = read_folder(tmp_path)
    assert car == BMW_320I
    assert again.time_step_s == pytest.approx(0.02)
    for name in Drive._fields[1:]:
        np.testing.assert_allclose(getattr(again, name), getattr(drive, name), rtol=1e-12)


def test_units_signs_and_offsets_are_applied(tmp_path: Path):
    drive = read(tmp_path, "0,90,32,36,72,1,a\n10,0,0,36,36,0,b\n", ratio=16.0)
    assert drive.time_step_s == pytest.approx(0.01)
    np.testing.assert_allclose(drive.yaw_rate_rad_s, [-np.pi / 2, 0], atol=1e-15)
    np.testing.assert_allclose(drive.steering_rad, np.radians([2.0, 0.0]))
    np.testing.assert_allclose(drive.speed_m_s, [15.0, 10.0])
    np.testing.assert_allclose(drive.lateral_acceleration_m_s2, [10.31, 0.5])
    assert np.isnan(drive.side_slip_rad).all()
    assert np.isnan(drive.wheel_speed_m_s[:, :2]).all()


def test_uneven_times_are_interpolated_and_gaps_are_not(tmp_path: Path):
    times = [0, 10, 20, 29, 41, 50, 60, 200, 210, 220]
    rows = "".join(f"{t},{2 * t},0,36,36,0,\n" for t in times)
    drive = read(tmp_path, rows)
    assert drive.steps == 23
    known = np.isfinite(drive.yaw_rate_rad_s)
    expected = -np.radians(2 * 10.0 * np.arange(23))
    np.testing.assert_allclose(drive.yaw_rate_rad_s[known], expected[known], atol=1e-12)
    assert (~known[7:20]).all()
    assert known[[0, 3, 6, 20, 22]].all()


def test_an_empty_field_is_not_known(tmp_path: Path):
    drive = read(tmp_path, "0,1,0,36,36,,\n10,1,0,36,36,2,\n20,,0,36,36,2,\n")
    assert np.isnan(drive.lateral_acceleration_m_s2[0])
    assert np.isnan(drive.yaw_rate_rad_s[2])


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("0,1,0,36,36,0,\n10,x,0,36,36,0,\n", r"drive\.csv:3: field 2 .* not a number"),
        ("0,1,0,36,36,0,\n10,1\n", r"drive\.csv:3"),
        ("0,1,0,36,36,0,\n", "at least two times"),
        ("0,1,0,36,36,0,\n0,1,0,36,36,0,\n", "drop repeated"),
        ("10,1,0,36,36,0,\n0,1,0,36,36,0,\n", "sort the lines"),
        ("", "at least two times"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, rows: str, says: str):
    with pytest.raises(ValueError, match=says):
        read(tmp_path, rows)


def test_a_missing_column_is_named_with_those_there_are(tmp_path: Path):
    file = log(tmp_path, "0,0\n", head="t,yaw\n")
    with pytest.raises(ValueError, match="no column 'wheel angle' for steering_wheel"):
        read_drive(file, columns_from_toml(MAP))


def test_what_spreadsheets_write_is_read_or_named(tmp_path: Path):
    row = "0,1,0,36,36,0,\n10,1,0,36,36,0,\n"
    file = log(tmp_path, row, head="\ufeff" + HEAD)
    assert read_drive(file, columns_from_toml(MAP)).steps == 2
    with pytest.raises(ValueError, match="semicolons or tabs"):
        read_drive(
            log(tmp_path, row.replace(",", ";"), HEAD.replace(",", ";")), columns_from_toml(MAP)
        )
    file.write_bytes((HEAD + "0,1,0,36,36,0,\xe9\n").encode("latin-1"))
    with pytest.raises(ValueError, match=r"drive\.csv: byte \d+ is not UTF-8"):
        read_drive(file, columns_from_toml(MAP))
    with pytest.raises(ValueError, match="the file is empty"):
        read_drive(log(tmp_path, "", head=""), columns_from_toml(MAP))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time =", "not TOML"),
        ('time = { column = "t", unit = "s" }', "yaw_rate"),
        (MAP.replace('"ms"', '"fortnight"'), "units are s, ms"),
        (MAP.replace("steering_wheel", "steeringwheel"), "steeringwheel"),
        (MAP.replace('steering_wheel = { column = "wheel angle", unit = "deg" }', ""), "neither"),
        (MAP.replace('rear_left_wheel = { column = "rl", unit = "km/h" }', ""), "both rear wheels"),
    ],
)
def test_a_bad_map_is_refused_by_what_is_wrong(text: str, says: str):
    with pytest.raises(ValueError, match=says):
        columns_from_toml(text)


def test_a_folder_without_its_files_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="no such folder"):
        read_folder(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"car\.toml"):
        read_folder(tmp_path)
