"""Several targets and the tracks that nodes report of them, step by step."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from concord.features.several_targets.scanned_swarm import PLACES, paths_of
from concord.features.several_targets.tracking.scores import CUTOFF_M, ORDER, gospa
from concord.features.several_targets.tracking.tracks import TrackReport, report_of
from concord.nodes.messages import Estimate
from concord.scenarios.setup import Setup


class NodeTracks(NamedTuple):
    """The tracks of a node, and their numbers (T,) in the order in which the network had them."""

    report: TrackReport
    numbers: tuple[int, ...]


class StepTracks(NamedTuple):
    """Targets and tracks of one step.

    Attributes:
        paths: states (K, 4) of the targets, NaN where one is not there.
        nodes: the tracks of each node, None of a node that told none.
        gospa_m, missed, false: GOSPA of each node and two of its parts (N,), NaN where it told
            none.
    """

    paths: np.ndarray
    nodes: tuple[NodeTracks | None, ...]
    gospa_m: np.ndarray
    missed: np.ndarray
    false: np.ndarray

    def of(self, node: int | None) -> NodeTracks | None:
        """Return the tracks of a node; of the first that told some where `node` is None."""
        if node is not None:
            return self.nodes[node]
        return next((tracks for tracks in self.nodes if tracks is not None), None)


class TracksTold:
    """Takes the steps of a network in order.

    A track has the same identity at all nodes. It is born when a first node reports it, and has
    died when no node does.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._numbers: dict[tuple[int, ...], int] = {}
        self._reported: set[int] = set()
        self._there: set[int] = set()

    def add(
        self, state: np.ndarray, estimates: Mapping[int, Estimate]
    ) -> tuple[StepTracks, list[str]]:
        """Return the tracks of a step with the plant's state, and births and deaths in words."""
        paths, nodes = paths_of(state), self._setup.scenario.nodes
        there = set(np.flatnonzero(np.isfinite(paths).all(axis=-1)).tolist())
        truth = paths[sorted(there)][:, PLACES]
        scores = np.full((3, nodes), np.nan)
        tracks: list[NodeTracks | None] = [None] * nodes
        for node, said in sorted(estimates.items()):
            if said.tracks is None:
                continue
            report = report_of(said.tracks.rows)
            numbers = tuple(self._number(identity) for identity in report.identity.tolist())
            tracks[node] = NodeTracks(report, numbers)
            of_step = gospa(truth, report.mean[:, PLACES], CUTOFF_M, ORDER)
            scores[:, node] = of_step.distance, of_step.missed, of_step.false
        reported = {number for one in tracks if one is not None for number in one.numbers}
        words = [
            *_words("target {} is there", there - self._there),
            *_words("target {} has left", self._there - there),
            *_words("track {} is born", reported - self._reported),
            *_words("track {} has died", self._reported - reported),
        ]
        self._there, self._reported = there, reported
        return StepTracks(paths, tuple(tracks), *scores), words

    def _number(self, identity: list[int]) -> int:
        return self._numbers.setdefault(tuple(identity), len(self._numbers) + 1)


def _words(sentence: str, numbers: set[int]) -> list[str]:
    return [sentence.format(number) for number in sorted(numbers)]
