"""The signals that a FIBEX or AUTOSAR document describes.

`SignalFormat` says where the elements of a signal stand in each format. A signal that
is no single number (texts, arrays, several scales) is left out by name.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from concord.features.flexray_tools.files.exchange import (
    Format,
    Triggering,
    find_cluster,
    triggerings,
)
from concord.features.flexray_tools.files.xml_document import (
    ClusterFileError,
    Element,
    number,
    parse_document,
)
from concord.features.flexray_tools.signals.coding import (
    MOST_BITS,
    Coding,
    DescribedSignals,
    FrameSignals,
    NumberType,
    PlacedSignal,
)


class NoNumber(ValueError):
    """A signal is no single number; says why."""


def lost(name: str, reference: str) -> "FoundSignal":
    """Return a signal whose reference leads nowhere."""

    def coding() -> Coding:
        raise NoNumber(f"its <{reference}> leads nowhere")

    return FoundSignal(name, 0, False, None, coding)


class FoundSignal(NamedTuple):
    """A signal in a frame: its name, place, length in bits and the elements of its coding."""

    name: str
    start_bit: int
    is_big_endian: bool
    update_bit: int | None
    coding: Callable[[], Coding]


class SignalFormat(NamedTuple):
    """How a format describes signals.

    Attributes:
        exchange: the format of clusters and triggerings.
        frame_names: (root) -> names of frames by their references.
        signals: (root) -> a function of a frame's reference that yields its signals.
    """

    exchange: Format
    frame_names: Callable[[Element], dict[str, str]]
    signals: Callable[[Element], Callable[[str], Iterator[FoundSignal]]]


def read_signals(
    form: SignalFormat, text: str | bytes, cluster: str | None = None
) -> DescribedSignals:
    """Return the signals of the frames on a cluster; `cluster` chooses it where there are several.

    Raises:
        ClusterFileError: the document describes no cluster, or no signal that is a number.
    """
    root = parse_document(text, form.exchange.name).root
    found: dict[Triggering, set[str]] = {}
    for one in triggerings(form.exchange, root, find_cluster(form.exchange, root, cluster)):
        found.setdefault(one._replace(channel=""), set()).add(one.channel)
    names, signals_of = form.frame_names(root), form.signals(root)
    frames: list[FrameSignals] = []
    left_out: dict[str, str] = {}
    for one, channels in found.items():
        placed = tuple(_placed(signals_of(one.frame), left_out))
        if placed:
            frames.append(
                FrameSignals(
                    names.get(one.frame, one.frame),
                    one.frame_id,
                    one.base_cycle,
                    one.repetition,
                    "".join(sorted(channels)),
                    placed,
                )
            )
    if not frames:
        why = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise ClusterFileError(
            f"no frame of the {form.exchange.name} file has a signal that is a number"
            f"{f' ({why[:200]})' if why else ''}; export it with its signals and PDUs"
        )
    return DescribedSignals(tuple(frames), left_out)


def _placed(found: Iterator[FoundSignal], left_out: dict[str, str]) -> Iterator[PlacedSignal]:
    for one in found:
        try:
            coding = one.coding()
        except NoNumber as why:
            left_out[one.name] = str(why)
            continue
        yield PlacedSignal(one.name, one.start_bit, one.is_big_endian, coding, one.update_bit)


class Scale(NamedTuple):
    """The straight line of a coding, and the spans of raw numbers that it has words for."""

    factor: float = 1.0
    offset: float = 0.0
    words: tuple[tuple[float, float], ...] = ()


def coding_of(
    bits: int,
    kind: NumberType,
    scale: Scale,
    unit: str,
    invalid: list[tuple[float, float]],
) -> Coding:
    """Return a coding with a scale.

    Raises:
        NoNumber: no number has so many bits.
    """
    if not 1 <= bits <= MOST_BITS or (kind == "float" and bits not in (32, 64)):
        wanted = "32 or 64" if kind == "float" else f"1 to {MOST_BITS}"
        raise NoNumber(f"it has {bits} bits, and a {kind} number {wanted}")
    return Coding(bits, kind, scale.factor, scale.offset, unit, (*scale.words, *invalid))


def scale_of(method: Element | None, space: str, where: str) -> Scale:
    """Return the straight line of a COMPU-METHOD; factor 1 and offset 0 where it has none.

    Raises:
        NoNumber: it has words alone, several scales, or is no straight line.
    """
    if method is None:
        return Scale()
    path = f"{space}COMPU-INTERNAL-TO-PHYS/{space}COMPU-SCALES/{space}COMPU-SCALE"
    scales = method.findall(path)
    lines = [
        coefficients
        for scale in scales
        if (coefficients := scale.find(f"{space}COMPU-RATIONAL-COEFFS")) is not None
    ]
    words = tuple(
        span_of(scale, space, where)
        for scale in scales
        if scale.find(f"{space}COMPU-CONST/{space}VT") is not None
    )
    if not lines and words:
        raise NoNumber("its coding is a table of words")
    if not lines:
        return Scale()
    if len(lines) > 1:
        raise NoNumber(f"its coding has {len(lines)} scales; one straight line is read")
    above, below = (
        [real(one.text, where) for one in lines[0].findall(f"{space}{tag}/{space}V")]
        for tag in ("COMPU-NUMERATOR", "COMPU-DENOMINATOR")
    )
    below = below or [1.0]
    if any(above[2:]) or any(below[1:]) or not below[0]:
        raise NoNumber("its coding is no straight line")
    if len(above) < 2 or not above[1]:
        raise NoNumber("its coding gives the same number for all bits")
    factor, offset = above[1] / below[0], above[0] / below[0]
    if not (abs(factor) < _MOST and abs(offset) < _MOST):
        raise NoNumber(f"its coding has the factor {factor:g} and the offset {offset:g}")
    return Scale(factor, offset, words)


def span_of(element: Element, space: str, where: str) -> tuple[float, float]:
    """Return the first and the last raw number between the limits of an element.

    Raises:
        ClusterFileError: a limit is no number.
    """
    ends = []
    for tag, end in (("LOWER-LIMIT", -math.inf), ("UPPER-LIMIT", math.inf)):
        limit = element.find(f"{space}{tag}")
        kind = "INFINITE" if limit is None else limit.get("INTERVAL-TYPE", "CLOSED")
        if limit is None or kind == "INFINITE" or not (limit.text or "").strip():
            ends.append(end)
        else:
            value = real(limit.text, where)
            ends.append(math.nextafter(value, -end) if kind == "OPEN" else value)
    return ends[0], ends[1]


def real(text: str | None, where: str) -> float:
    """Return the number that a text says.

    Raises:
        ClusterFileError: it says none that is finite.
    """
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ClusterFileError(f"{where}: {(text or '')[:40]!r} must be a number")
    return value


# No number of a signal becomes infinite: raw ones have 64 bits.
_MOST = 1e280
# Longer than every payload, so that a number of the file asks for no memory.
_MOST_POSITION = 1 << 20


def integer(element: Element, tag: str, where: str) -> int:
    """Return the whole number in a child element: a place or a length in bits.

    Raises:
        ClusterFileError: there is none.
    """
    value = number(element, tag, int, where)
    if value is None or not 0 <= value < _MOST_POSITION:
        name = tag.rpartition("}")[2]
        said = "missing" if value is None else value
        raise ClusterFileError(
            f"{where}: element <{name}> is {said}; it must be from 0 to {_MOST_POSITION - 1}"
        )
    return value


def update_bit(element: Element, tag: str, before: int, where: str) -> int | None:
    """Return the place of an update bit, so many bits after; None where there is none."""
    return None if element.find(tag) is None else before + integer(element, tag, where)
