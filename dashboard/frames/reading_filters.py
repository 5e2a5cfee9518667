"""The filters of a page that take the readings of each step, from wherever the sensors stand."""

from collections.abc import Iterable, Iterator

import numpy as np

from concord.dashboard.frames.innovations import InnovationsTold, StepNis
from concord.dashboard.frames.network import NetworkStatus
from concord.dashboard.frames.stage import Stage
from concord.dashboard.frames.told import StepContent, StepReader, delivered
from concord.filters.gaussian import Gaussian
from concord.runtime.whole_steps import WholeStep
from concord.scenarios.baselines import BaselineContent, baseline_step, filters_step_by_step
from concord.scenarios.moves import with_moves
from concord.scenarios.setup import Setup


class CentralisedFilter:
    """Takes the readings of each step; it ends with the first step that it misses.

    A filter that begins in the middle from the prior would seem worse than the nodes.
    """

    def __init__(self, stage: Stage) -> None:
        setup = stage.setup
        self._stage, self._taken = stage, -1
        prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
        self._content = BaselineContent(prior)
        self._advance = None
        if filters_step_by_step(setup):
            self._advance = baseline_step(setup, list(range(stage.nodes)))

    def follow(self, setup: Setup) -> None:
        """Take the sensors of this setup from now on."""
        if self._advance is not None:
            self._advance = baseline_step(setup, list(range(self._stage.nodes)))

    def take_over(self, readings: Iterable[WholeStep]) -> Iterator[int]:
        """Take the readings of the steps before the first frame; yield the number of each."""
        reader = StepReader(self._stage.setup, self._stage.bus.frame_format)
        for step in readings:
            self.add(step.number, reader.read(step))
            yield step.number

    def add(self, number: int, told: StepContent) -> Gaussian | None:
        """Take a step; return the belief after it, None where the filter cannot be followed."""
        if number != self._taken + 1:
            self._advance = None
        self._taken = number
        if self._advance is None:
            return None
        readings, driven = delivered(told, self._stage.nodes)
        if readings is None:
            return None
        self._content = self._advance(self._content, number, readings, driven)
        return self._content.belief


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
