"""Waveforms: text and back, samples, spikes, and files that are something else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.flexray_tools.recordings.csv_recording import parse_csv
from concord.features.flexray_tools.recordings.vcd_recording import parse_vcd
from concord.features.flexray_tools.recordings.waveform import (
    Waveform,
    WaveformError,
    from_samples,
    without_spikes,
)
from tests.bus.support import quick
from tests.features.flexray_tools.signals import encode_bits, format_waveform, from_bits

SIGNAL = from_bits([(1000.0, encode_bits(bytes(range(12)), 9))], 100.0)


def equal(one: Waveform, other: Waveform) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_text_and_file_survive_the_round_trip(tmp_path):
    reading = parse_csv(format_waveform(SIGNAL))
    assert equal(reading.signal(), SIGNAL)
    assert reading.unreadable == 0


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
    reading = parse_csv(text[:-2])
    assert reading.unreadable == 1
    assert len(reading.signal().times_ns) == len(SIGNAL.times_ns) - 1


def test_time_that_goes_backwards_is_refused():
    with pytest.raises(WaveformError, match="backwards, from 20 to 10 ns"):
        parse_csv("0,1\n20,0\n10,1\n")


@pytest.mark.parametrize(
    "line", ["inf,1", "1e999,0", "nan,1", "9223372036854775808,1", "1,inf", "1"]
)
def test_numbers_that_are_no_time_or_level_are_counted(line: str):
    assert parse_csv(f"0,1\n20,0\n{line}\n").unreadable == 1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("\x7fELF\x02\n\x00\x01", "no 'time_ns,level'"),
        ("hello\nworld\n", "no 'time_ns,level'"),
        ("9\n", "no 'time_ns,level'"),
        ("1,2.5\n2,1.3\n", "volts .* --threshold 1.9"),
    ],
)
def test_other_files_are_refused(text: str, named: str):
    with pytest.raises(WaveformError, match=named):
        parse_csv(text)


@quick
@given(st.text(alphabet="0123456789.,-+einfa\n \x00", max_size=120))
def test_any_text_is_read_or_refused(text: str):
    try:
        recording = parse_csv(text)
    except WaveformError:
        return
    assert recording.unreadable <= len(text.splitlines())
    for signal in recording.signals.values():
        assert np.all(np.diff(signal.times_ns) > 0)


@pytest.mark.parametrize(
    ("heading", "scale"),
    [
        ("time_ns,level", 1),
        ("time_us,level", 1e-3),
        ("Time [s],Channel 0", 1e-9),
        ("Time(ms);D0", 1e-6),
        ("Time [\N{MICRO SIGN}s]\tD0", 1e-3),
        ("level,Time_us", 1e-3),
    ],
)
def test_the_heading_says_the_unit_and_the_columns(heading: str, scale: float):
    separator = next(mark for mark in ",;\t" if mark in heading)
    names = heading.split(separator)
    place = next(i for i, name in enumerate(names) if "time" in name.lower())
    rows = []
    for time, level in zip(SIGNAL.times_ns.tolist(), SIGNAL.levels.tolist(), strict=True):
        fields = [str(level)]
        fields.insert(place, f"{time * scale:.12f}")
        rows.append(separator.join(fields))
    recording = parse_csv("; made by a test\n" + heading + "\n" + "\n".join(rows))
    assert equal(recording.signal(), SIGNAL)
    assert list(recording.signals) == [names[1 - place]]


def test_fractions_without_a_unit_are_refused_and_the_unit_may_be_stated():
    text = "".join(
        f"{time / 1e3!r},{level}\n"
        for time, level in zip(SIGNAL.times_ns.tolist(), SIGNAL.levels.tolist(), strict=True)
    )
    for heading in ("", "time,level\n"):
        with pytest.raises(WaveformError, match="--unit"):
            parse_csv(heading + text)
        assert equal(parse_csv(heading + text, "us").signal(), SIGNAL)


def test_of_several_columns_the_one_that_changes_or_the_one_asked_for():
    rows = list(zip(SIGNAL.times_ns.tolist(), SIGNAL.levels.tolist(), strict=True))
    still = "time_ns,A,B\n" + "".join(f"{time},1,{level}\n" for time, level in rows)
    assert equal(parse_csv(still).signal(), SIGNAL)
    both = "time_ns,A,B\n" + "".join(f"{time},{1 - level},{level}\n" for time, level in rows)
    with pytest.raises(WaveformError, match=r"several signals that change .'A', 'B'.*--column"):
        parse_csv(both).signal()
    assert equal(parse_csv(both).signal("B"), SIGNAL)
    assert equal(parse_csv(both).signal("A"), SIGNAL.inverted())
    with pytest.raises(WaveformError, match="no column 'C'; the recording has 'A', 'B'"):
        parse_csv(both).signal("C")


def vcd(timescale: str, tick_ns: float) -> str:
    """A dump of the signal beside one that stands still, a bus of four bits, and an x."""
    head = (
        f"$date today $end $timescale {timescale} $end $scope module top $end\n"
        '$var wire 1 ! D0 $end $var wire 1 " D1 $end $var wire 4 # bus [3:0] $end\n'
        '$upscope $end $enddefinitions $end\n#0 $dumpvars x! 1" b0101 # $end\n'
    )
    changes = zip(SIGNAL.times_ns.tolist(), SIGNAL.levels.tolist(), strict=True)
    return head + "".join(f"#{round(time / tick_ns)} {level}!\n" for time, level in changes)


@pytest.mark.parametrize(
    ("timescale", "tick_ns"), [("1 ns", 1), ("100ns", 100), ("10 ps", 0.01), ("1 us", 1000)]
)
def test_a_value_change_dump_is_read_in_its_timescale(timescale: str, tick_ns: float):
    recording = parse_vcd(vcd(timescale, tick_ns))
    assert list(recording.signals) == ["D0", "D1"] and recording.unreadable == 1
    if tick_ns <= 100:
        assert equal(recording.signal(), SIGNAL)
        assert equal(recording.signal("D0"), SIGNAL)


@pytest.mark.parametrize("text", ["", "$timescale 1 ns $end", "$var wire 1 ! D0 $end", "#0 1!"])
def test_a_dump_without_its_declarations_is_refused(text: str):
    with pytest.raises(WaveformError, match=r"needs \$timescale"):
        parse_vcd(text)
    with pytest.raises(WaveformError, match="time '#-5'"):
        parse_vcd(vcd("1 ns", 1) + "#-5 1!")


@quick
@given(st.text(alphabet="#$!01xz tend\n", max_size=80))
def test_any_dump_is_read_or_refused(changes: str):
    try:
        parse_vcd(vcd("1 ns", 1) + changes)
    except WaveformError:
        return
