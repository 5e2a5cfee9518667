"""Records that a node keeps for the steps of its window, each under its source and step."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.rules.labelled.frame import Labelled
from concord.nodes.rules.labelled.record_sets import (
    RecordSets,
    newest_first,
    no_records,
    one_step_on,
    packed,
    with_record,
)
from concord.nodes.rules.labelled.window_filter import WindowFilter, Windows, fuse_base, one_lane
from concord.nodes.rules.lane_rule import Failures


class KeptRecords(NamedTuple):
    """The window, and the records in it.

    Attributes:
        windows: the window to filter. records: what was taken by which source, for each place of
            the window. held: the same as a set (W, B).
        waiting: own records that the sensor has yet to deliver, the oldest first.
        unread: (place, source) of the records that the window does not have yet.
    """

    windows: Windows
    records: tuple[Mapping[int, bytes], ...]
    held: RecordSets
    waiting: tuple[bytes | None, ...]
    unread: tuple[tuple[int, int], ...] = ()

    @property
    def newest(self) -> int:
        """The place of the step."""
        return len(self.records) - 1

    @property
    def nodes(self) -> int:
        """The number of sources."""
        return self.windows.values.shape[2]

    def step_begun(
        self, filter: WindowFilter, control: np.ndarray | None, own: int, record: bytes | None
    ) -> "KeptRecords":
        """Return them a step later, with the `own` records that the sensor delivers in it."""
        record, *waiting = (*self.waiting, record)
        moved = self._replace(
            windows=filter.opened(self.windows, control),
            records=(*self.records[1:], {}),
            held=one_step_on(self.held),
            waiting=tuple(waiting),
        )
        if record is None:
            return moved
        return moved._with({(self.newest - len(waiting), own): record})

    def received(self, records: Iterable[Labelled]) -> tuple["KeptRecords", int]:
        """Return them with the records of a share, and how many of these came too late.

        The first copy stays: a label is counted once, whatever comes under it.
        """
        late, new = 0, dict[tuple[int, int], bytes]()
        for source, age, record in records:
            place = self.newest - age
            if place < self.windows.first:
                late += 1
            elif source not in self.records[place]:
                new.setdefault((place, source), record)
        return self._with(new), late

    def _with(self, new: Mapping[tuple[int, int], bytes]) -> "KeptRecords":
        """With records by place and source that are not held yet."""
        held, records = self.held, list(self.records)
        for (place, source), record in new.items():
            held = with_record(held, place, source)
            records[place] = {**records[place], source: record}
        return self._replace(records=tuple(records), unread=(*self.unread, *new), held=held)

    def filtered(self, filter: WindowFilter) -> tuple["KeptRecords", Failures]:
        """Return them with the window filtered again, and what went wrong."""
        windows, failures = filter.filtered(self._read(filter))
        return self._replace(windows=windows, unread=()), failures

    def _read(self, filter: WindowFilter) -> Windows:
        """The window with what the unread records say."""
        if not self.unread:
            return self.windows
        places = sorted({place for place, _ in self.unread})
        readings = np.full((1, len(places), self.nodes, *filter.sensors.delivered), np.nan)
        for place, source in self.unread:
            codec = filter.codecs[source]
            assert codec is not None, "the frame codec knows no such source"
            readings[0, places.index(place), source] = codec.decode(self.records[place][source])
        windows = filter.with_readings(self.windows, np.array(places), readings)
        return windows._replace(right=np.minimum(windows.right, places[0]))

    def fused(self, filter: WindowFilter, checkpoint: Gaussian) -> tuple["KeptRecords", str]:
        """Return them with a base fused with a checkpoint, and what became of it in a word."""
        base, sound, gains = fuse_base(filter, self.windows.base, one_lane(checkpoint))
        if not sound.all():
            return self, "failed"
        if not gains.any():
            return self, "known"
        right = np.zeros_like(self.windows.right)
        return self._replace(windows=self.windows._replace(base=base, right=right)), "fused"

    def set_of(self, records: Iterable[Labelled]) -> RecordSets:
        """Return the set (W, B) of the records of a share that belong to the window."""
        flags = np.zeros((len(self.records), self.nodes), dtype=bool)
        for source, age, _ in records:
            flags[self.newest - age, source] = self.newest - age >= self.windows.first
        return packed(flags)

    def labelled(self, chosen: RecordSets) -> Iterator[Labelled]:
        """Yield the records of a set (W, B), the newest first."""
        for place, source in newest_first(chosen, self.nodes):
            yield Labelled(source, self.newest - place, self.records[place][source])

    @property
    def lengths(self) -> np.ndarray:
        """Bytes of each record, (W, N)."""
        lengths = np.zeros((len(self.records), self.nodes), dtype=np.int64)
        for place, some in enumerate(self.records):
            for source, record in some.items():
                lengths[place, source] = len(record)
        return lengths

    @property
    def labels(self) -> set[tuple[int, int]]:
        """The (step, source) of each record."""
        step_at = self.windows.step_at
        return {(step_at(p), source) for p, some in enumerate(self.records) for source in some}


def nothing_kept(windows: Windows, late_steps: int) -> KeptRecords:
    """Return a window without records; the sensor delivers so many steps late."""
    width, nodes = windows.values.shape[1:3]
    held = no_records((), width, nodes)
    return KeptRecords(windows, ({},) * width, held, (None,) * late_steps)
