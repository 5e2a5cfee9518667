"""Recordings as VCD, the value change dump of IEEE 1364, which logic analysers export.

Reads variables of one bit; levels x and z say nothing. pyvcd reads the same, and much that no
recording of a bus needs.
"""

import re
from collections.abc import Iterator

from concord.features.flexray_tools.recordings.waveform import (
    MAX_TIME_NS,
    RecordedSignals,
    WaveformError,
    from_samples,
)

_SECONDS_NS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "ps": 1e-3, "fs": 1e-6}
_TIMESCALE = re.compile(r"(1|10|100)\s*(s|ms|us|ns|ps|fs)")


def parse_vcd(text: str) -> RecordedSignals:
    """Read the signals of a value change dump; changes that say no level are counted.

    Raises WaveformError if it has no timescale or no variable of one bit.
    """
    head, found, body = text.partition("$enddefinitions")
    sections = list(_sections(head))
    scales = [_TIMESCALE.search(words) for keyword, words in sections if keyword == "timescale"]
    timescale = scales[0] if scales else None
    names = dict(_variables(sections))
    if not found or timescale is None or not names:
        raise WaveformError(
            "the VCD file needs $timescale, a $var of one bit and $enddefinitions; export the "
            "digital signal anew"
        )
    scale = int(timescale[1]) * _SECONDS_NS[timescale[2]]
    samples: dict[str, tuple[list[int], list[int]]] = {code: ([], []) for code in names}
    time, unreadable = 0, 0
    words = iter(body.split())
    for word in words:
        code = word[1:]
        if word[0] in "bBrR":
            # The code of a vector is a word of its own.
            next(words, None)
        elif word[0] == "#":
            if not code.isdecimal() or int(code) * scale > MAX_TIME_NS:
                raise WaveformError(f"the VCD file has the time {word[:20]!r}; export it anew")
            time = round(int(code) * scale)
        elif code in samples and word[0] in "01":
            samples[code][0].append(time)
            samples[code][1].append(int(word[0]))
        elif code in samples and word[0] in "xXzZ":
            unreadable += 1
    signals = {names[code]: from_samples(*pair) for code, pair in samples.items()}
    return RecordedSignals(signals, unreadable)


def _sections(head: str) -> Iterator[tuple[str, str]]:
    """Keyword and words of each declaration."""
    for section in head.split("$end"):
        keyword, *words = section.split() or [""]
        yield keyword.lstrip("$"), " ".join(words)


def _variables(sections: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Code and name of each variable of one bit: `wire 1 ! name`; equal names get their code."""
    taken: set[str] = set()
    for keyword, words in sections:
        parts = words.split()
        if keyword == "var" and len(parts) >= 4 and parts[1] == "1":
            name = parts[3] if parts[3] not in taken else f"{parts[3]} {parts[2]}"
            taken.add(name)
            yield parts[2], name
