"""Logs in the forms that other programs write: equal arrays, or one sentence with a cure."""

import runpy
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from concord.plants.recorded.channels import ChannelReadings, SamplingInstants, grid_over
from concord.plants.recorded.columns import Column, LogMap, map_from_toml, read_channels
from concord.plants.recorded.log_files import open_log

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases" / "own_data"
needs_cases = pytest.mark.skipif(not CASES.is_dir(), reason="no ../shared/cases/own_data to read")


class Rows(LogMap, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Two quantities."""

    si_units: ClassVar[Mapping[str, str]] = {"yaw_rate": "rad/s", "speed": "m/s"}
    yaw_rate: Column
    speed: Column


MAP = """
time = { column = "time", unit = "s" }
yaw_rate = { column = "yaw_rate", unit = "rad/s" }
speed = { column = "speed", unit = "m/s" }
"""
PLAIN = "time,yaw_rate,speed\n0.00,0.1,\n0.01,-0.2,20.5\n0.02,0.3,21\n"
HEAD, FIRST, SECOND, THIRD = PLAIN.splitlines(keepends=True)
NO_UNITS = MAP.replace(', unit = "rad/s"', "").replace(', unit = "m/s"', "")
DATED = PLAIN.replace("\n0.0", "\n2026-06-01{}12:00:00.0")
IN_NS = "".join(
    [HEAD, *(f"{1_780_315_200_000_000_000 + k * 10_000_000},{rest}" for k, rest in enumerate(
        ["0.1,\n", "-0.2,20.5\n", "0.3,21\n"]))]
)  # fmt: skip
FORMS = {
    "plain": (PLAIN, MAP),
    "byte order mark": ("\ufeff" + PLAIN, MAP),
    "line ends of Windows": (PLAIN.replace("\n", "\r\n"), MAP),
    "units": (HEAD + "s,rad/s,m/s\n" + FIRST + SECOND + THIRD, MAP),
    "units in brackets": (HEAD + "[sec],[rad/s],(m/s)\n" + FIRST + SECOND + THIRD, MAP),
    "units taken": (HEAD + "s,rad/s,m/s\n" + FIRST + SECOND + THIRD, NO_UNITS),
    "units converted": (
        HEAD + "s,rad/s,km/h\n0,0.1,\n0.01,-0.2,73.8\n0.02,0.3,75.6\n",
        NO_UNITS,
    ),
    "comments": (f"# car 1\n% a, b\n{HEAD}# 12:00\n{FIRST}% x\n{SECOND}{THIRD}\n# end\n", MAP),
    "names in a comment": ("# car 1\n# " + PLAIN, MAP),
    "names of rostopic": ("%" + PLAIN, MAP),
    "semicolons": (PLAIN.replace(",", ";"), MAP),
    "decimal commas": (PLAIN.replace(",", ";").replace(".", ","), MAP),
    "tabs": (PLAIN.replace(",", "\t"), MAP),
    "dates": (DATED.format(*"   "), MAP),
    "dates in UTC": (DATED.format(*"TTT").replace("0,0.", "0Z,0.").replace("1,-", "1Z,-")
                     .replace("2,0.", "2Z,0."), MAP),
    "nanoseconds": (IN_NS, MAP.replace('"s"', '"ns"')),
    **{word: (PLAIN.replace("0.1,\n", f"0.1,{word}\n"), MAP) for word in ("nil", "NA", "NaN")},
    "a row again": (PLAIN + THIRD, MAP),
    "out of order": (HEAD + THIRD + FIRST + SECOND, MAP),
}  # fmt: skip
SAID = {
    "a row again": "1 equal readings of one stamp came again, and count once",
    "out of order": "1 readings have an earlier stamp than the one before; sorted by stamps",
}


def read(folder: Path, text: str, columns: str = MAP) -> dict[str, ChannelReadings]:
    (folder / "drive.csv").write_bytes(text.encode())
    rows = map_from_toml(columns, Rows)
    return read_channels(folder, rows.columns, rows)


@pytest.mark.parametrize("form", FORMS)
def test_each_written_form_gives_equal_arrays(form: str, tmp_path: Path, capsys):
    channels = read(tmp_path, *FORMS[form])
    since_s = 1_780_315_200.0 if "dates" in form or form == "nanoseconds" else 0.0
    for name, stamps_s, values in (
        ("yaw_rate", [0, 0.01, 0.02], [0.1, -0.2, 0.3]),
        ("speed", [0.01, 0.02], [20.5, 21.0]),
    ):
        came_s = channels[name].stamps_s - since_s
        np.testing.assert_allclose(came_s, stamps_s, rtol=0, atol=3e-7 if since_s else 0)
        np.testing.assert_allclose(channels[name].values, values, rtol=1e-15)
    said = SAID.get(form, "")
    told = capsys.readouterr().err
    assert told == (f"{tmp_path / 'drive.csv'}: {said} (yaw_rate, speed)\n" if said else "")


@pytest.mark.parametrize("zone", ["+02:00", "-05:00"])
def test_the_zone_of_a_date_counts(zone: str, tmp_path: Path):
    text = HEAD + "".join(f"2026-06-01T12:00:0{k}{zone},{k},1\n" for k in range(2))
    expected = 1_780_315_200.0 - 3600 * int(zone[:3])
    assert read(tmp_path, text)["yaw_rate"].stamps_s[0] == expected


STRAY = PLAIN + "1780315200,0.4,22\n"
REFUSED = {
    "a unit of its own": (
        HEAD + "s,deg/s,m/s\n" + FIRST, MAP,
        "drive.csv: 'yaw_rate' for yaw_rate is in deg/s by the file, but in rad/s by the column "
        'map; write unit = "deg/s" in the map',
    ),
    "a unit of another quantity": (HEAD + "s,m,m/s\n" + FIRST, NO_UNITS,
                                   "has the unit m; write unit = with one of rad/s, deg/s"),
    "no unit": (PLAIN, NO_UNITS, "has no unit; write unit = with one of rad/s, deg/s"),
    "dates in ms": (DATED.format(*"   "), MAP.replace('"s"', '"ms"'),
                    "'time' for time of yaw_rate is in s by the file, but in ms"),
    "a word": (PLAIN.replace("-0.2", "fast"), MAP, "drive.csv: line 3: field 2 (yaw_rate) is "
               "'fast', which is not a number; write one, or leave the field empty"),
    "a word below comments": ("# a\n" + PLAIN.replace("-0.2", "fast"), MAP, "csv: line 4: field 2"),
    "not a date": (DATED.format(*"   ") + "noon,1,1\n", MAP,
                   "line 5: field 1 (time) is 'noon', which is not an ISO 8601 date"),
    "a date of the clock": (DATED.format(*"   ") + "now,1,1\n", MAP,
                            "line 5: field 1 (time) is 'now', which is not an ISO 8601 date"),
    "two kinds of decimals": ("time;yaw_rate;speed\n0;0,1;1\n1;0.2;1\n", MAP,
                              "line 2: field 2 (yaw_rate) is '0,1', which is not a number"),
    "a short line": (HEAD + FIRST + "0.01,1\n", MAP,
                     "line 3 has 2 fields and none for 'speed', field 3"),
    "no names": (FIRST + SECOND, MAP, "line 1 holds numbers, and no line above it the names"),
    "other values": (PLAIN + "0.02,0.5,21\n", MAP,
                     "line 4 and line 5 have the time 0.02 s and other values"),
    "no time": (PLAIN.replace("0.01", "nil"), MAP, "line 3 has no time; give it one"),
    "a stray stamp": (STRAY, MAP, "drive.csv: 'yaw_rate' for yaw_rate: line 5 has the time "
                      "1780315200 s, 1.78032e+09 s after the nearest in time (line 4); remove"),
    "a jump of hours": (PLAIN + "7200,0.4,22\n7200.01,0.4,22\n", MAP, "line 5 has the time 7200 s"),
    "an unset stamp": (IN_NS + "0,1,1\n", MAP.replace('"s"', '"ns"'),
                       "line 5 has the time 0 s, 1.78032e+09 s before the nearest in time"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_is_wrong_is_named_with_its_cure(fault: str, tmp_path: Path):
    text, columns, says = REFUSED[fault]
    with pytest.raises(ValueError) as refused:
        read(tmp_path, text, columns)
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_a_span_of_too_many_steps_is_refused_before_it_is_allocated():
    two = ChannelReadings(np.array([0.0, 1e9]), np.zeros(2))
    with pytest.raises(ValueError, match=r"speed has the time 1000000000 s, a gap of 1e\+09 s"):
        grid_over({"speed": two}, 0.005)
    slow = ChannelReadings(7200.0 * np.arange(3), np.zeros(3))
    assert grid_over({"level": slow}, 7200.0) == SamplingInstants(0.0, 7200.0, 3)


def test_a_bag_is_refused_with_the_command_that_converts(tmp_path: Path):
    with pytest.raises(ValueError, match=r"rosbags-convert --src .*drive\.bag --dst .*drive --dst"):
        open_log(tmp_path / "drive.bag")


def test_the_command_for_a_file_of_matlab_converts_it(tmp_path: Path):
    scipy_io = pytest.importorskip("scipy.io")
    pytest.importorskip("pandas")
    scipy_io.savemat(tmp_path / "drive.mat", {"time": [0.0, 0.1], "speed": [1.0, 2.0], "a": "b"})
    with pytest.raises(ValueError, match=r"drive\.mat: ") as refused:
        open_log(tmp_path / "drive.mat")
    _, command, _ = str(refused.value).split("`")
    python = command.replace("python", f"'{sys.executable}'", 1)
    subprocess.run(python, shell=True, check=True)
    np.testing.assert_array_equal(open_log(tmp_path / "drive.csv").series("speed"), [1.0, 2.0])


STAMPED = """std_msgs/Header header
float64[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id"""


def mcap(folder: Path, stamps_s: list[int], lengths: list[int]) -> Path:
    """Messages with arrays of these lengths, logged a second apart, beside a topic of events."""
    writer_of = pytest.importorskip("mcap_ros2.writer").Writer
    with (folder / "drive.mcap").open("wb") as stream:
        writer = writer_of(stream)
        schema = writer.register_msgdef("test_msgs/msg/Stamped", STAMPED)
        for k, (stamp_s, length) in enumerate(zip(stamps_s, lengths, strict=True)):
            header = {"stamp": {"sec": stamp_s, "nanosec": 0}, "frame_id": ""}
            message = {"header": header, "data": [float(k)] * length}
            writer.write_message("/a", schema, message, (100 + k) * 1_000_000_000)
        raw = writer._writer  # the writer of ROS 2 cannot write what it cannot decode
        broken = raw.register_schema("test_srvs/srv/Event", "ros2msg", b"no_such/Kind info")
        channel = raw.register_channel("/svc/_service_event", "cdr", broken)
        raw.add_message(channel, 100_000_000_000, b"\0\1\0\0", 100_000_000_000)
        writer.finish()
    return folder / "drive.mcap"


def test_a_topic_that_cannot_be_decoded_is_skipped_and_named(tmp_path: Path, capsys):
    file = open_log(mcap(tmp_path, [0, 1, 2], [0, 1, 2]))
    assert file.unread == ("/svc/_service_event",)
    np.testing.assert_array_equal(file.stamps_s("/a.data[1]"), [0, 1, 2])
    np.testing.assert_array_equal(file.series("/a.data[1]"), [np.nan, np.nan, 2])
    columns = 'file = "drive.mcap"\n' + "".join(
        f'{name} = {{ column = "{series}", unit = "{unit}" }}\n'
        for name, series, unit in (("yaw_rate", "/a.data[0]", "rad/s"), ("speed", "/b.x", "m/s"))
    )
    with pytest.raises(ValueError, match=r"no column '/b.x' .*cannot be decoded: /svc/_service_ev"):
        rows = map_from_toml(columns, Rows)
        read_channels(tmp_path, rows.columns, rows)
    said = capsys.readouterr().err
    assert said.endswith("drive.mcap: skipped what cannot be decoded: /svc/_service_event\n")


def test_headers_that_are_all_0_were_never_stamped(tmp_path: Path):
    file = open_log(mcap(tmp_path, [0, 0, 0], [1, 1, 1]))
    np.testing.assert_array_equal(file.stamps_s("/a.data[0]"), [100, 101, 102])


@needs_cases
@pytest.mark.parametrize("name", ["comment_lines", "iso_stamps", "repeated_row", "units_row"])
def test_each_case_file_is_read(name: str, tmp_path: Path):
    channels = read(tmp_path, (CASES / f"{name}.csv").read_text())
    count = {"comment_lines": 1}.get(name, 2)
    np.testing.assert_array_equal(channels["yaw_rate"].values, [0.01] * count)
    np.testing.assert_array_equal(channels["speed"].values, [20.0] * count)


@needs_cases
def test_time_of_a_simulation_begins_at_0(tmp_path: Path, monkeypatch, capsys):
    pytest.importorskip("mcap_ros2")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["sim_time.py", str(ROOT)])
    runpy.run_path(str(CASES / "sim_time.py"))
    assert capsys.readouterr().out.split() == ["[0.", "0.01", "0.02", "0.03", "0.04]"]


def column_of(numbers: list[float], folder: Path, said: str = "") -> ChannelReadings:
    """The speed of a log with these numbers; `said` stands in the column map."""
    rows = "".join(f"{0.01 * k:.2f},0.1,{value!r}\n" for k, value in enumerate(numbers))
    (folder / "drive.csv").write_text(HEAD + rows)
    known = map_from_toml(said + MAP, Rows)
    return read_channels(folder, known.columns, known)["speed"]


SOUND = [20.0 + 0.1 * (k % 7) for k in range(60)]


@pytest.mark.parametrize("absent", [65535.0, -32768.0, 1e38, -1e38, 255.0, 4711.0])
def test_a_number_that_stands_for_none_is_refused_then_left_out(
    absent: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    numbers = [absent if k % 20 == 9 else value for k, value in enumerate(SOUND)]
    cure = rf"in 3 of 60 readings.*write not_available = \[{absent:.9g}\] in the column map"
    with pytest.raises(ValueError, match=cure.replace("+", r"\+")):
        column_of(numbers, tmp_path)
    read = column_of(numbers, tmp_path, f"not_available = [{absent!r}]\n")
    np.testing.assert_array_equal(read.values, [v for v in numbers if v != absent])
    assert "3 readings say that there is none, and are left out (speed)" in capsys.readouterr().err
    # A user who knows better keeps them.
    assert len(column_of(numbers, tmp_path, "not_available = []\n").values) == 60


def test_two_numbers_that_stand_for_none_do_not_hide_each_other(tmp_path: Path):
    numbers = [65535.0 if k % 20 == 9 else 65534.0 if k == 5 else v for k, v in enumerate(SOUND)]
    with pytest.raises(ValueError, match=r"in 4 of 60 readings.*= \[65534, 65535\] in the column"):
        column_of(numbers, tmp_path)
    assert len(column_of(numbers, tmp_path, "not_available = [65534, 65535]\n").values) == 56


@pytest.mark.parametrize(
    "numbers",
    [
        SOUND,
        [5.0 if k % 25 == 3 else 1e-3 * (-1) ** k for k in range(200)],  # pulses
        [0.0] * 30 + [1.0] * 5,  # a brake light
        [*SOUND, 90.0],  # one outlier
        [float(k) for k in range(300)],  # goes through 127 and 255
        [0.0, 255.0] * 20,  # a counter of one byte
        [1e-3 * (-1) ** k for k in range(20)],
    ],
    ids=["sound", "pulses", "two levels", "outlier", "ramp", "counter", "small"],
)
def test_readings_of_a_sound_sensor_are_all_taken(numbers: list[float], tmp_path: Path):
    assert len(column_of(numbers, tmp_path).values) == len(numbers)
