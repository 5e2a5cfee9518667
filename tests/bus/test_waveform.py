"""Waveforms: text and back, samples, spikes, and files that are something else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.recordings.waveform import (
    Waveform,
    WaveformError,
    from_samples,
    parse_waveform,
    without_spikes,
)
from tests.bus.signals import encode_bits, format_waveform, from_bits
from tests.bus.support import quick

SIGNAL = from_bits([(1000.0, encode_bits(bytes(range(12)), 9))], 100.0)


def equal(one: Waveform, other: Waveform) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_text_and_file_survive_the_round_trip(tmp_path):
    reading = parse_waveform(format_waveform(SIGNAL))
    assert equal(reading.waveform, SIGNAL)
    assert reading.unreadable_lines == 0


def test_every_bit_is_where_it_was_put():
    bits = encode_bits(bytes(range(12)), 9)
    for place, bit in enumerate(bits):
        middle = 1000 + 100 * place + 50
        assert SIGNAL.levels[np.searchsorted(SIGNAL.times_ns, middle) - 1] == bit


@quick
@given(st.lists(st.integers(0, 1), min_size=1, max_size=60))
def test_samples_at_a_clock_give_the_same_signal_as_changes(levels: list[int]):
    signal = from_samples(range(0, 10 * len(levels), 10), levels)
    assert np.all(np.diff(signal.levels.astype(int)) != 0)
    for place, level in enumerate(levels):
        assert signal.levels[np.searchsorted(signal.times_ns, 10 * place, "right") - 1] == level


@quick
@given(st.sets(st.integers(0, len(SIGNAL.times_ns) - 2), max_size=8), st.integers(1, 29))
def test_spikes_are_taken_away_and_nothing_else(places: set[int], width: int):
    times, levels = SIGNAL.times_ns.tolist(), SIGNAL.levels.tolist()
    for place in sorted(places, reverse=True):
        start = int(times[place]) + 40
        times[place + 1 : place + 1] = [start, start + width]
        levels[place + 1 : place + 1] = [1 - levels[place], levels[place]]
    noisy = Waveform(np.array(times), np.array(levels))
    assert equal(without_spikes(noisy, 30), SIGNAL)


def test_a_cut_last_line_is_counted():
    text = format_waveform(SIGNAL)
    reading = parse_waveform(text[:-2])
    assert reading.unreadable_lines == 1
    assert len(reading.waveform.times_ns) == len(SIGNAL.times_ns) - 1


def test_time_that_goes_backwards_is_refused():
    with pytest.raises(WaveformError, match="backwards, from 20 to 10 ns"):
        parse_waveform("0,1\n20,0\n10,1\n")


@pytest.mark.parametrize(
    "line", ["inf,1", "1e999,0", "nan,1", "9223372036854775808,1", "1,inf", "1"]
)
def test_numbers_that_are_no_time_or_level_are_counted(line: str):
    assert parse_waveform(f"0,1\n20,0\n{line}\n").unreadable_lines == 1


@pytest.mark.parametrize(
    "text", ["\x7fELF\x02\n\x00\x01", "hello\nworld\n", "1,2.5\n2,1.3\n", "9\n"]
)
def test_other_files_are_refused(text: str):
    with pytest.raises(WaveformError, match="no 'time_ns,level'"):
        parse_waveform(text)


@quick
@given(st.text(alphabet="0123456789.,-+einfa\n \x00", max_size=120))
def test_any_text_is_read_or_refused(text: str):
    try:
        waveform, unreadable = parse_waveform(text)
    except WaveformError:
        return
    assert unreadable <= len(text.splitlines())
    assert np.all(np.diff(waveform.times_ns) > 0)
