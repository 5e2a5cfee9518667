"""`concord flexray wcrt`: bounds of a slot table, missed deadlines, and a recording's pipeline."""

from pathlib import Path

import pytest

from tests.experiments.command_support import concord, refused

TABLE = """
[[slots]]
frame_id = 52
payload_bytes = 88
node = 3
deadline_us = 6000.0

[[slots]]
frame_id = 60
payload_bytes = 20
node = 1
repetition = 2
deadline_us = 9000.0

[[slots]]
frame_id = 300
payload_bytes = 2
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "slots.toml"
    path.write_text(TABLE)
    return path


def test_bounds_deadlines_and_starved_frames_are_told(table: Path, capsys):
    wcrt = ("flexray", "wcrt", table, "--cluster", "audi")
    first, second, third = concord(capsys, *wcrt, "--json").json()["frames"]
    # 5,000 us, the action point of two macroticks and 12 + 10 x 96 bits.
    action_point_us = 2 * 5000 / 2778
    assert first["worst_us"] == pytest.approx(5000 + action_point_us + 97.2)
    assert first["spare_us"] == pytest.approx(6000 - first["worst_us"])
    assert second["worst_us"] > 10_000 and second["spare_us"] < 0
    assert third["worst_us"] is None and third["spare_us"] is None
    text = concord(capsys, *wcrt).out
    assert "frame ID 60: 10131.8 us exceed the deadline of 9000 us by 1131.8 us" in text
    assert "frame ID 300: lower IDs may keep it beyond minislot 225" in text
    assert "2 of 3 frames are bounded" in text


def test_mistakes_are_one_sentence(table: Path, tmp_path: Path, capsys):
    assert "volkswagen" in refused(
        concord(capsys, "flexray", "wcrt", table, "--cluster", "volkswagen")
    )
    missing = tmp_path / "none.toml"
    assert "No such file" in refused(
        concord(capsys, "flexray", "wcrt", missing, "--cluster", "audi")
    )
    table.write_text(TABLE.replace("88", "300"))
    assert "frame ID 52" in refused(concord(capsys, "flexray", "wcrt", table, "--cluster", "audi"))


def test_the_cars_recording_gives_a_table_whose_frames_never_miss_a_cycle(
    shared_data: Path, tmp_path: Path, capsys
):
    car = shared_data / "flexray_capture" / "audi_cycles_28_35.csv"
    if not car.exists():
        pytest.skip("needs ../shared/data/flexray_capture")
    cluster, slots = tmp_path / "car.toml", tmp_path / "slots.toml"
    made = ("--out", cluster, "--slots", slots, "--cycle-us", 5000)
    assert concord(capsys, "flexray", "fit", car, *made).code == 0
    answer = concord(capsys, "flexray", "wcrt", slots, "--cluster", cluster, "--json").json()
    dynamic = [frame for frame in answer["frames"] if frame["frame_id"] > 51]
    assert len(dynamic) == 11
    assert all(frame["filled_cycles"] == 0 and frame["exact"] for frame in dynamic)
    waits = [frame["worst_us"] - 5000 * frame["repetition"] for frame in dynamic]
    # Published for the same frame IDs by a rough bound: 5.02 to 5.81 ms.
    assert min(waits) == pytest.approx(20, abs=5) and max(waits) == pytest.approx(800, abs=20)
