"""The histories of many runs of a network, as arrays."""

from typing import NamedTuple

import numpy as np

from concord.results.records.extras import RunExtra
from concord.results.records.record_spread import RecordSpread
from concord.results.records.trace import Past
from concord.scenarios.innovations import Innovations
from concord.scenarios.setup import Setup


class RunCost(NamedTuple):
    """Cost of the runs."""

    seconds: float
    peak_memory_mb: float


class Histories(NamedTuple):
    """Histories of R runs of N nodes on E links, of n states, in S steps of L rounds.

    Attributes:
        setup: the setup of the runs.
        runs: (R,), their numbers.
        truth: (R, S, n), NaN where it is unknown.
        control: (R, S, p) that drove the plant into a step, NaN for the first; None for a plant
            that is not driven.
        mean: (R, S, N, n), estimates after the last round of a step.
        cov_trace: (R, S, N), of their covariances.
        nees: (R, S, N), over the states `definition_of(...).score.nees_states`; NaN for unknown
            truth.
        payload_bytes: (R, S, L, N), sent by a node in a communication cycle; 0 if it sent nothing.
        asked: (R, S, L, N), True where a node bid for the dynamic segment.
        classes: (R, S, L, N), the urgency class in whose frame ID a node won; else 0.
        counters: totals (R, N) by name, as nodes count them; what never happened has no name.
        prior_mean: (R, n), where filters began.
        readings: (R, S, N, r, d), NaN where none was taken. If kept.
        ages: (R, S, E), cycles since what came over a link was sent, -1 never; links in order of
            receiver and then sender, as in `setup.neighbours`. If kept.
        cov: (R, S, N, n, n). If kept.
        innovations: (R, S, N, r, m), of the nodes' own readings. If kept, and where nodes filter.
        past: smoothed states, (R, S, L, N, n), of rules that estimate them (`Past`).
        suspect: (R, S, N), which nodes say that their belief does not fit what they have heard;
            None for rules that do not check.
        spreads: of labelled records, one of each run; empty for rules without.
        extras: what nodes tell beside their beliefs, of each run; empty for scenarios without
            `RunExtras`.
    """

    setup: Setup
    runs: np.ndarray
    truth: np.ndarray
    control: np.ndarray | None
    mean: np.ndarray
    cov_trace: np.ndarray
    nees: np.ndarray
    payload_bytes: np.ndarray
    asked: np.ndarray
    classes: np.ndarray
    counters: dict[str, np.ndarray]
    prior_mean: np.ndarray
    readings: np.ndarray | None
    ages: np.ndarray | None
    cov: np.ndarray | None
    innovations: Innovations | None
    past: Past | None
    suspect: np.ndarray | None
    spreads: tuple[RecordSpread, ...]
    extras: tuple[RunExtra, ...] = ()

    def of(self, place: slice) -> "Histories":
        """Return those of some of the runs."""
        whole = self._asdict()
        arrays = {name: one[place] for name, one in whole.items() if isinstance(one, np.ndarray)}
        several = {
            name: None if one is None else type(one)(*(part[place] for part in one))
            for name, one in (("innovations", self.innovations), ("past", self.past))
        }
        return self._replace(
            **arrays,
            **several,
            counters={name: counts[place] for name, counts in self.counters.items()},
            spreads=self.spreads[place],
            extras=self.extras[place],
        )
