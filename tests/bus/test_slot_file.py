"""Slot tables as files: there and back, and mistakes by name."""

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.presets import AUDI
from concord.bus.flexray.slot_file import SlotFileError, read_slot_file, slots_to_toml
from tests.bus.support import quick


@st.composite
def slots(draw: st.DrawFn) -> list[MessageSlot]:
    made: list[MessageSlot] = []
    for frame_id in sorted(draw(st.sets(st.integers(1, 2047), min_size=1, max_size=6))):
        repetition = draw(st.sampled_from([1, 2, 4, 8, 16, 32, 64]))
        most = 34 if frame_id <= 51 else 254
        period_us = draw(st.none() | st.floats(1, 1e6))
        slot = MessageSlot(
            frame_id=frame_id,
            payload_bytes=2 * draw(st.integers(0, most // 2)),
            node=draw(st.integers(0, 9)),
            base_cycle=draw(st.integers(0, repetition - 1)),
            repetition=repetition,
            period_us=period_us,
            offset_us=None if period_us is None else draw(st.none() | st.floats(0, 1e6)),
            deadline_us=draw(st.none() | st.floats(1, 1e6)),
        )
        made.append(slot)
    return made


@quick
@given(slots())
def test_what_is_written_is_read(tmp_path_factory, made: list[MessageSlot]):
    path = tmp_path_factory.mktemp("slots") / "slots.toml"
    path.write_text(slots_to_toml(made))
    assert read_slot_file(path, AUDI) == tuple(made)


GOOD = "[[slots]]\nframe_id = 60\npayload_bytes = 88\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("slots = ", "no slot table"),
        ("[[slots]]\nframe_id = 60\n", "payload_bytes"),
        (GOOD + "colour = 1\n", "colour"),
        (GOOD.replace("60", "0"), "frame IDs are 1 to 2047"),
        (GOOD.replace("88", "87"), "an even number from 0 to 254"),
        (GOOD.replace("60", "3"), "static frame of cluster 'audi' carries an even number from 0"),
        (GOOD + "repetition = 3\n", "1, 2, 4, ..., 64"),
        (GOOD + "repetition = 2\nbase_cycle = 2\n", "must be 0 to 1"),
        (GOOD + "node = -1\n", "nodes are numbered from 0"),
        (GOOD + "urgency_class = -1\n", "classes are numbered from 0"),
        (GOOD + 'channel = "B"\n', "channel is B, but cluster 'audi' has A"),
        (GOOD + "period_us = nan\n", "period_us is nan"),
        (GOOD + "offset_us = 5.0\n", "offset_us is 5.0; it needs a period_us"),
        (GOOD + "deadline_us = -1\n", "deadline_us is -1"),
        (GOOD + GOOD + "repetition = 4\nnode = 2\n", "nodes 0 and 2 send in the same cycle"),
    ],
)
def test_mistakes_are_one_sentence_with_the_frame(text: str, said: str, tmp_path: Path):
    path = tmp_path / "slots.toml"
    path.write_text(text)
    with pytest.raises(SlotFileError) as refused:
        read_slot_file(path, AUDI)
    assert said in str(refused.value) and str(path) in str(refused.value)
    with pytest.raises(SlotFileError, match="No such file"):
        read_slot_file(tmp_path / "none.toml", AUDI)


def test_one_frame_id_may_change_its_sender_from_cycle_to_cycle(tmp_path: Path):
    path = tmp_path / "slots.toml"
    turns = "repetition = 2\nbase_cycle = {0}\nnode = {0}\n"
    path.write_text(GOOD + turns.format(0) + GOOD + turns.format(1))
    assert [slot.node for slot in read_slot_file(path, AUDI)] == [0, 1]
    other_channel = '\nchannel = "B"\n'
    path.write_text(GOOD + GOOD + other_channel)
    redundant = msgspec.structs.replace(AUDI, channels="AB")
    assert len(read_slot_file(path, redundant)) == 2
