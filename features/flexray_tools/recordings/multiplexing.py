"""In which cycles of a recording a frame ID carried data, and what that proves."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import NamedTuple

from concord.bus.flexray.cluster_parameters import Segment
from concord.features.flexray_tools.recordings.decoder import DecodedFrame

REPETITIONS = (2, 4, 8, 16, 32, 64)
LARGEST_CHANCE = 0.01


class Multiplex(NamedTuple):
    """When a frame ID carried data: in which `cycles` of the `recorded_cycles` counters seen.

    Base and smallest repetition for which `cycle % repetition == base` says exactly these, once two
    full periods were recorded and chance is an unlikely cause; None otherwise.
    """

    frame_id: int
    segment: Segment
    cycles: tuple[int, ...]
    recorded_cycles: int
    base_cycle: int | None
    repetition: int | None


def multiplexing(
    cycles: Sequence[Sequence[DecodedFrame]], static_slots: int
) -> tuple[Multiplex, ...]:
    """Return for each frame ID of these cycles when it carried data."""
    recorded = Counter(cycle[0].frame.cycle_count for cycle in cycles)
    seen: dict[int, set[int]] = {}
    for cycle in cycles:
        for decoded in cycle:
            counts = seen.setdefault(decoded.frame.frame_id, set())
            if not decoded.frame.null:
                counts.add(decoded.frame.cycle_count)
    return tuple(
        multiplex(frame_id, counts, recorded, static_slots)
        for frame_id, counts in sorted(seen.items())
    )


def multiplex(
    frame_id: int, seen: Set[int], recorded: Mapping[int, int], static_slots: int
) -> Multiplex:
    """Return when a frame ID carried data that was `seen` at these cycle counters.

    `recorded` says how many cycles of each counter the recording has.
    """
    claim = _base_and_repetition(seen, recorded) or (None, None)
    segment: Segment = "static" if frame_id <= static_slots else "dynamic"
    return Multiplex(frame_id, segment, tuple(sorted(seen)), len(recorded), *claim)


def _base_and_repetition(seen: Set[int], recorded: Mapping[int, int]) -> tuple[int, int] | None:
    for repetition in REPETITIONS:
        bases = {cycle % repetition for cycle in seen}
        if len(bases) != 1:
            continue
        (base,) = bases
        periods = [0] * repetition
        for cycle, times in recorded.items():
            periods[cycle % repetition] += times
        if seen != _turns(recorded, base, repetition) or min(periods) < 2:
            continue
        sent = sum(recorded[cycle] for cycle in seen)
        if _chance(sent, sum(recorded.values()), repetition) < LARGEST_CHANCE:
            return base, repetition
    return None


def _turns(recorded: Iterable[int], base: int, repetition: int) -> set[int]:
    return {cycle for cycle in recorded if cycle % repetition == base}


def _chance(sent: int, recorded: int, repetition: int) -> float:
    """Chance that a sender without a schedule, who sends as often, hits one of the patterns."""
    often = sent / recorded
    return repetition * often**sent * (1 - often) ** (recorded - sent)
