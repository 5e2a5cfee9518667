"""`concord.features.several_targets.scan_flooding` at all nodes of all runs at once.

Records are flooded in arrays. Tracks are computed lane by lane, by the function of a node; lanes
with equal records share the result (`KeptTracks`).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.features.several_targets.scan_flooding import (
    Reached,
    StepRecords,
    TrackedWindow,
    TrackStep,
    reported_tracks,
)
from concord.features.several_targets.tracking.tracker import Tracked
from concord.features.several_targets.tracking.tracks import number_of_targets
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import Counters, added
from concord.nodes.lanes.labelled import BatchedFlooding, BatchedLabelledContent
from concord.nodes.lanes.network import ShareContents
from concord.nodes.messages import ReportedTracks

Records = tuple[Mapping[int, bytes], ...]
"""Records of a run by source, for each step of the window, the oldest first."""


class BatchedScanContent(NamedTuple):
    """Knowledge of all nodes: records, and the window of each node of each run; `belief` (R, N, 1)
    is the number of targets."""

    flooded: BatchedLabelledContent
    records: tuple[Records, ...]
    windows: tuple[tuple[TrackedWindow, ...], ...]
    belief: Gaussian


@dataclass(frozen=True)
class BatchedScanFlooding:
    """The fields are those of `concord.features.several_targets.scan_flooding.ScanFlooding`."""

    flooding: BatchedFlooding
    track: TrackStep
    begin: Tracked
    undetected: float
    moments: Callable[[Gaussian], Gaussian]

    def start(self, prior: Gaussian) -> BatchedScanContent:
        """No record and no track, in as many runs as there are priors."""
        runs, nodes = prior.mean.shape[:2]
        settled = Reached(self.flooding.first_step - 1, self.begin, (), b"")
        windows = ((TrackedWindow(settled, ()),) * nodes,) * runs
        return BatchedScanContent(
            self.flooding.start(prior),
            (({},) * self.flooding.frames.window_steps,) * runs,
            windows,
            self._numbers(windows),
        )

    def begin_step(
        self,
        content: BatchedScanContent,
        readings: np.ndarray,
        control: np.ndarray | None,
        step: int,
    ) -> BatchedScanContent:
        """Let the oldest step leave the windows, and record the own scans."""
        flooded = self.flooding.begin_step(content.flooded, readings, control, step)
        taken = [dict(self._records(scans)) for scans in readings]
        records = tuple(
            (*before[1:], now) for before, now in zip(content.records, taken, strict=True)
        )
        return _with_flooded(content, flooded)._replace(records=records)

    def _records(self, scans: np.ndarray) -> Iterator[tuple[int, bytes]]:
        """Yield the records of scans (N, 1 + D, m) by node."""
        for node, (codec, scan) in enumerate(zip(self.flooding.filter.codecs, scans, strict=True)):
            record = None if codec is None else codec.encode(scan)
            if record is not None:
                yield node, record

    def bids(self, content: BatchedScanContent, nodes: np.ndarray) -> np.ndarray:
        """Return the urgency of the records that neighbours of these nodes (C,) lack."""
        return self.flooding.bids(content.flooded, nodes)

    def body_bytes(self, content: BatchedScanContent, nodes: np.ndarray) -> np.ndarray:
        """Return the lengths (R, C) of the shares that these nodes (C,) would compose now."""
        return self.flooding.body_bytes(content.flooded, nodes)

    def exchange(
        self, content: BatchedScanContent, sends: np.ndarray, lost: np.ndarray | None
    ) -> BatchedScanContent:
        """End a group; at the end of a step compute the tracks."""
        content = _with_flooded(content, self.flooding.exchange(content.flooded, sends, lost))
        rounds = content.flooded.cycle - self.flooding.first_cycle
        if content.flooded.group or rounds % self.flooding.rounds:
            return content
        return self._tracked(content)

    def _tracked(self, content: BatchedScanContent) -> BatchedScanContent:
        flooded = content.flooded
        is_full = flooded.windows.first == 0
        held = flooded.kept.flags
        windows = tuple(
            tuple(
                window.after(self.track, steps, is_full)
                for window, steps in zip(of_run, self._steps(content, run, held[run]), strict=True)
            )
            for run, of_run in enumerate(content.windows)
        )
        approximated = [[one.last.tracked.approximated for one in of_run] for of_run in windows]
        more = {"approximated-cluster": np.array(approximated)}
        flooded = flooded._replace(counters=added(flooded.counters, more))
        return content._replace(flooded=flooded, windows=windows, belief=self._numbers(windows))

    def _steps(
        self, content: BatchedScanContent, run: int, held: np.ndarray
    ) -> Iterator[list[tuple[int, StepRecords]]]:
        """Yield for each node the records that it holds (N, W, N), by step."""
        windows, records = content.flooded.windows, content.records[run]
        equal: dict[tuple[int, bytes], StepRecords] = {}
        for flags in held:
            steps = []
            for place in range(windows.first, len(records)):
                key = place, flags[place].tobytes()
                if key not in equal:
                    sources = np.flatnonzero(flags[place]).tolist()
                    equal[key] = tuple((source, records[place][source]) for source in sources)
                steps.append((windows.step_at(place), equal[key]))
            yield steps

    def _numbers(self, windows: tuple[tuple[TrackedWindow, ...], ...]) -> Gaussian:
        found = [
            [number_of_targets(one.last.tracked.tracks, self.undetected) for one in of_run]
            for of_run in windows
        ]
        return Gaussian(
            np.array([[one.mean for one in of_run] for of_run in found]),
            np.array([[one.cov for one in of_run] for of_run in found]),
        )

    def belief(self, content: BatchedScanContent) -> Gaussian:
        """The number of targets."""
        return content.belief

    def tracks(self, content: BatchedScanContent) -> list[list[ReportedTracks]]:
        """The tracks that stand for targets, of each node of each run."""
        return [
            [
                reported_tracks(one.last.tracked.tracks, one.last.evidence, self.moments)
                for one in of_run
            ]
            for of_run in content.windows
        ]

    def ages(self, content: BatchedScanContent) -> np.ndarray:
        """Cycles since the last share over each link was sent."""
        return self.flooding.ages(content.flooded)

    def counters(self, content: BatchedScanContent) -> Counters:
        """Return the totals."""
        return self.flooding.counters(content.flooded)

    def spread(self, content: BatchedScanContent) -> ShareContents:
        """Return the contents of the step's shares, and the records held at its end."""
        return self.flooding.spread(content.flooded)


def _with_flooded(
    content: BatchedScanContent, flooded: BatchedLabelledContent
) -> BatchedScanContent:
    """Return the content with these records; no neighbour is owed a checkpoint."""
    return content._replace(flooded=flooded._replace(owed=np.zeros_like(flooded.owed)))
