"""The tracks that the batched driver tells step by step, as those of runs."""

import numpy as np

from concord.features.several_targets.tracks_trace import TracksTrace, tracks_trace
from concord.nodes.messages import ReportedTracks
from concord.runtime.batched.driver import Instant
from concord.scenarios.setup import Setup


class TracksOfRuns:
    """Tracks and true states of R runs, as they come to be known."""

    def __init__(self, setup: Setup, runs: int) -> None:
        self._setup = setup
        self._truth: list[np.ndarray] = []
        self._told: list[dict[tuple[int, int], ReportedTracks | None]] = [{} for _ in range(runs)]

    @property
    def there(self) -> bool:
        """Whether the runs have tracks."""
        return bool(self._truth)

    def add(self, instant: Instant) -> None:
        """One step more."""
        if instant.tracks is None:
            return
        self._truth.append(instant.truth)
        for told, of_run in zip(self._told, instant.tracks, strict=True):
            told.update({(instant.step, node): one for node, one in enumerate(of_run)})

    def of_runs(self) -> list[TracksTrace]:
        """Return the tracks of each run after its last step; none where the runs have none."""
        if not self.there:
            return []
        truth = np.stack(self._truth, axis=1)
        traces = (tracks_trace(self._setup, *one) for one in zip(truth, self._told, strict=True))
        return [one for one in traces if one is not None]
