"""Logged drives: what is read is what was written, in SI, and mistakes are named."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.drive_log import (
    columns_from_toml,
    read_folder,
    read_log,
    write_drive,
)
from concord.features.vehicle.plant.network import HEADING
from concord.features.vehicle.plant.parameters import BMW_320I, car_to_toml
from concord.features.vehicle.plant.replay import replayed

MAP = """
time = { column = "t", unit = "ms" }
yaw_rate = { column = "yaw", unit = "deg/s", scale = -1.0 }
steering_wheel = { column = "wheel angle", unit = "deg" }
rear_left_wheel = { column = "rl", unit = "km/h" }
rear_right_wheel = { column = "rr", unit = "km/h" }
lateral_acceleration = { column = "ay", unit = "g", offset = 0.5 }
"""
HEAD = "t,yaw,wheel angle,rl,rr,ay,comment\n"


def log(folder: Path, rows: str, head: str = HEAD, ratio: float = 1.0) -> Path:
    (folder / "columns.toml").write_text(MAP)
    (folder / "car.toml").write_text(car_to_toml(replace(BMW_320I, steering_ratio=ratio)))
    (folder / "drive.csv").write_text(head + rows)
    return folder


def read(folder: Path, rows: str, ratio: float = 1.0) -> Drive:
    return read_folder(log(folder, rows, ratio=ratio)).drive


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


def test_inputs_are_interpolated_up_to_gaps_and_readings_count_once(tmp_path: Path):
    times = [0, 10, 20, 29, 41, 50, 60, 200, 210, 220]
    drive = read(tmp_path, "".join(f"{t},{2 * t},{3 * t},36,36,0,\n" for t in times))
    assert drive.steps == 23
    grid = 10.0 * np.arange(23)
    known = np.isfinite(drive.steering_rad)
    np.testing.assert_allclose(drive.steering_rad[known], np.radians(3 * grid[known]), atol=1e-12)
    assert (~known[7:20]).all() and known[:7].all() and known[20:].all()
    came = np.isfinite(drive.yaw_rate_rad_s)
    np.testing.assert_allclose(drive.yaw_rate_rad_s[came], -np.radians(2.0 * np.array(times)))
    np.testing.assert_array_equal(np.flatnonzero(came), [0, 1, 2, 3, 4, 5, 6, 20, 21, 22])


def test_a_gap_is_one_of_its_own_channel(tmp_path: Path):
    """Wheels at a tenth of the rate of the yaw rate have no gap: it was 12 % of them once."""
    rows = "".join(
        f"{t},{t},{'' if t % 50 else 7},{'' if t % 50 else 36},{'' if t % 50 else 36},,\n"
        for t in range(0, 1001, 5)
    )
    drive = read(tmp_path, rows)
    assert drive.time_step_s == pytest.approx(0.005)
    np.testing.assert_allclose(drive.steering_rad, np.radians(7.0))
    np.testing.assert_allclose(drive.speed_m_s, 10.0)


def test_at_shorter_steps_inputs_go_on_and_readings_still_count_once(tmp_path: Path):
    rows = "".join(f"{t},{2 * t},{3 * t},36,36,,\n" for t in range(0, 200, 10))
    drive = read_folder(log(tmp_path, rows), longest_step_s=0.005).drive
    assert drive.time_step_s == 0.005 and drive.steps == 39
    assert np.isfinite(drive.steering_rad).all()
    np.testing.assert_array_equal(
        np.flatnonzero(np.isfinite(drive.yaw_rate_rad_s)), range(0, 39, 2)
    )


def test_lines_out_of_order_are_readings_at_their_times(tmp_path: Path):
    rows = [f"{t},{2 * t},{3 * t},36,36,0,\n" for t in range(0, 100, 10)]
    expected = read(tmp_path, "".join(rows))
    rows[3], rows[6] = rows[6], rows[3]
    for came, ought in zip(read(tmp_path, "".join(rows)), expected, strict=True):
        np.testing.assert_array_equal(came, ought)


def test_a_delay_is_taken_off_the_stamps(tmp_path: Path):
    folder = log(tmp_path, "0,1,0,36,36,0,\n10,1,0,36,36,0,\n")
    late = MAP.replace('unit = "deg/s",', 'unit = "deg/s", delay_s = 0.004,')
    (folder / "columns.toml").write_text(late)
    channels = read_log(folder).channels
    np.testing.assert_allclose(channels["yaw_rate"].stamps_s, [-0.004, 0.006], atol=1e-15)
    np.testing.assert_allclose(channels["steering"].stamps_s, [0.0, 0.01])


def test_satellites_of_a_log_are_a_sensor(tmp_path: Path):
    folder = log(tmp_path, "0,1,0,36,36,0,90\n10,1,0,36,36,0,\n", head=HEAD)
    more = MAP + 'course = { column = "comment", unit = "deg", scale = -1.0 }\n'
    (folder / "columns.toml").write_text(more)
    channels, car = read_log(folder)
    plant = replayed(channels, car, 0.005)
    np.testing.assert_allclose(plant.exact[:, 3, 0, 1], [-np.pi / 2, np.nan, np.nan])
    _, mean, _ = plant.initial(np.zeros(6))
    assert mean[HEADING] == pytest.approx(-np.pi / 2)


def test_an_empty_field_is_not_known(tmp_path: Path):
    drive = read(tmp_path, "0,1,0,36,36,,\n10,1,0,36,36,2,\n20,,0,36,36,2,\n")
    assert np.isnan(drive.lateral_acceleration_m_s2[0])
    assert np.isnan(drive.yaw_rate_rad_s[2])


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("0,1,0,36,36,0,\n10,x,0,36,36,0,\n", r"drive\.csv: line 3: field 2 .* not a number"),
        ("0,1,0,36,36,0,\n10,1\n", r"drive\.csv: line 3"),
        ("0,1,0,36,36,0,\n", "yaw_rate has fewer than two readings"),
        (
            "0,1,0,36,36,0,\n0,2,0,36,36,0,\n",
            "line 2 and line 3 have the time 0 s .* drop repeated",
        ),
        (",1,0,36,36,0,\n0,1,0,36,36,0,\n", "'yaw' for yaw_rate: line 2 has no time"),
        ("", "yaw_rate has fewer than two readings"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, rows: str, says: str):
    with pytest.raises(ValueError, match=says):
        read(tmp_path, rows)


def test_a_missing_column_is_named_with_those_there_are(tmp_path: Path):
    with pytest.raises(ValueError, match="no column 'wheel angle' for steering_wheel"):
        read_folder(log(tmp_path, "0,0\n", head="t,yaw\n"))


def test_a_column_without_a_time_is_refused(tmp_path: Path):
    folder = log(tmp_path, "0,1,0,36,36,0,\n10,1,0,36,36,0,\n")
    (folder / "columns.toml").write_text("".join(MAP.splitlines(keepends=True)[2:]))
    with pytest.raises(ValueError, match="no time for yaw_rate; name the column of its stamps"):
        read_folder(folder)


def test_a_file_of_another_kind_is_refused(tmp_path: Path):
    folder = log(tmp_path, "0,1,0,36,36,0,\n10,1,0,36,36,0,\n")
    (folder / "columns.toml").write_text('file = "drive.tdms"\n' + MAP)
    with pytest.raises(
        ValueError, match=r"drive\.tdms: a log is read from files that end in \.csv"
    ):
        read_folder(folder)


def test_what_spreadsheets_write_is_read_or_named(tmp_path: Path):
    row = "0,1,0,36,36,0,\n10,1,0,36,36,0,\n"
    assert read_folder(log(tmp_path, row, head="\ufeff" + HEAD)).drive.steps == 2
    (tmp_path / "drive.csv").write_bytes((HEAD + "0,1,0,36,36,0,\xe9\n").encode("latin-1"))
    with pytest.raises(ValueError, match=r"drive\.csv: byte \d+ is not UTF-8"):
        read_folder(tmp_path)
    with pytest.raises(ValueError, match="the file is empty"):
        read_folder(log(tmp_path, "", head=""))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time =", "not TOML"),
        ('time = { column = "t", unit = "s" }', "yaw_rate"),
        (MAP.replace('"ms"', '"fortnight"'), "units are s, ms"),
        (MAP.replace('"deg/s"', '"km/h"'), "yaw_rate in 'km/h'; units are rad/s, deg/s"),
        (MAP.replace('"ms"', '"m"'), "time in 'm'; units are s, ms, us, ns"),
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


def test_stamps_in_ns_and_speeds_in_knots_are_read(tmp_path: Path):
    """Receivers give knots, and the clocks of recorders count nanoseconds since 1970."""
    start = 1_700_000_000_000_000_000
    rows = "".join(f"{start + k * 10_000_000},1,0,36,36,0,\n" for k in range(5))
    folder = log(tmp_path, rows)
    in_ns = MAP.replace('"ms"', '"ns"').replace('"km/h"', '"kn"')
    (folder / "columns.toml").write_text(in_ns)
    drive = read_folder(folder).drive
    assert drive.time_step_s == pytest.approx(0.01, rel=1e-4)
    np.testing.assert_allclose(drive.speed_m_s, 18.52)


def driven(folder: Path, **changes: str) -> Path:
    """A drive through curves, with the map changed."""
    turns = 10 * np.sin(0.1 * np.arange(100))
    folder = log(
        folder, "".join(f"{10 * k},{-y},{y},36,36,{y / 50},\n" for k, y in enumerate(turns))
    )
    text = MAP.replace(", offset = 0.5", "")
    for name, change in changes.items():
        head, line, tail = text.partition(f"\n{name} = {{")
        assert line, name
        text = head + line + tail.replace(" }", f", {change} }}", 1)
    (folder / "columns.toml").write_text(text)
    return folder


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rear_left_wheel": "delay_s = 50.0"}, "rear_left_wheel was read from -50 to -49.01 s"),
        ({"time": "scale = 1000"}, "steering has a reading every 10 s"),
        ({"steering_wheel": "scale = -1"}, "yaw_rate and steering point to opposite sides"),
        ({"lateral_acceleration": "scale = -1"}, "yaw_rate and lateral_acceleration point to"),
    ],
)
def test_units_and_signs_that_no_drive_has_are_refused(tmp_path: Path, changes, says: str):
    """A clock of its own took all memory; a sign was taken for side slip."""
    assert len(read_log(driven(tmp_path)).channels["yaw_rate"].values) == 100
    with pytest.raises(ValueError, match=f"columns.toml: {says}"):
        read_log(driven(tmp_path, **changes))


def test_a_straight_drive_with_offsets_of_either_sign_is_read(tmp_path: Path):
    noise = 0.01 * np.random.default_rng(1).standard_normal((100, 2))
    rows = [f"{10 * k},{-0.3 + y},{-2.0 + d},36,36,0,\n" for k, (y, d) in enumerate(noise)]
    assert len(read_log(log(tmp_path, "".join(rows))).channels["steering"].values) == 100
