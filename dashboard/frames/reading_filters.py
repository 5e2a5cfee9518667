"""The filters of a page that take the readings of each step, from wherever the sensors stand."""

import numpy as np

from concord.dashboard.frames.centralised import CentralisedFilter
from concord.dashboard.frames.innovations import InnovationsTold, StepNis
from concord.dashboard.frames.network import NetworkStatus
from concord.dashboard.frames.stage import Stage
from concord.dashboard.frames.told import StepContent
from concord.filters.gaussian import Gaussian
from concord.scenarios.moves import with_moves


class ReadingFilters:
    """The filter that hears everything, and the innovations of the nodes."""

    def __init__(self, stage: Stage) -> None:
        self.centralised = CentralisedFilter(stage)
        self._innovations = InnovationsTold(stage.setup)
        self._start, self._moves = stage.setup, list[tuple[int, str]]()

    def follow(self, network: NetworkStatus) -> None:
        """Take the sensors from now on where they stand in this network."""
        placement = network.settings.get("placement")
        if placement is None or [placement] == [where for _, where in self._moves[-1:]]:
            return
        self._moves.append((network.anchor[0], placement))
        moved = with_moves(self._start, self._moves)
        self.centralised.follow(moved)
        self._innovations.follow(moved)

    def add(
        self, number: int, told: StepContent, after: Gaussian, alive: np.ndarray
    ) -> tuple[Gaussian | None, StepNis]:
        """The belief of the filter that hears everything after a step, None where it cannot be
        followed, and the innovations of the living nodes (N,), whose beliefs are then `after`."""
        return (
            self.centralised.add(number, told),
            self._innovations.add(number, told, after, alive),
        )
