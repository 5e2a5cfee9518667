"""The record of runs: what one run, or many of one setup, came to, as arrays."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.history import History
from concord.results.records.extras import Past, RunExtra
from concord.scenarios.catalogue import scored_nees
from concord.scenarios.innovations import Innovations, innovations_of_nodes
from concord.scenarios.preparation import with_settings
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    from concord.results.records.record_spread import RecordSpread
    from concord.results.records.trace import Trace


class RunCost(NamedTuple):
    """Cost of the runs."""

    seconds: float
    peak_memory_mb: float


class Runs(NamedTuple):
    """R runs of N nodes on E links, of n states, in S steps of at most L rounds.

    While a node was out, its entries are NaN, its ages -1, and it sent nothing. So they are in real
    time where its estimate was late.

    Attributes:
        setup: the setup of the runs.
        runs: (R,), their numbers.
        links: receiver and sender (E,) of each link, in that order; of every graph of the run.
        truth: (R, S, n), NaN where it is unknown.
        control: (R, S, p) that drove the plant into a step, NaN for the first; None for a plant
            that is not driven.
        mean: (R, S, N, n), estimates after the last round of a step.
        cov_trace: (R, S, N), of their covariances.
        nees: (R, S, N), over the states `definition_of(...).score.nees_states`; NaN for unknown
            truth.
        payload_bytes: (R, S, L, N), sent by a node in a communication cycle, all frames together; 0
            if it sent nothing.
        asked: (R, S, L, N), True where a node bid for the dynamic segment.
        classes: (R, S, L, N), the urgency class in whose frame ID a node won; else 0.
        counters: totals (R, N) by name, as nodes count them; what never happened has no name.
        prior_mean: (R, n), where filters began.
        readings: (R, S, N, r, d), NaN where none was taken. If kept.
        ages: (R, S, E), cycles since what came over a link was sent, -1 never. If kept.
        cov: (R, S, N, n, n). If kept.
        innovations: (R, S, N, r, m), of the nodes' own readings. If kept, and where nodes filter.
        past: smoothed states, (R, S, L, N, n), of rules that estimate them (`Past`).
        suspect: (R, S, N), which nodes say that their belief does not fit what they have heard;
            None for rules that do not check.
        spreads: of labelled records, one of each run; empty for rules without, and where the
            network changed.
        extras: what nodes tell beside their beliefs, of each run; empty for scenarios without
            `RunExtras`.
        cut: (R, S, L, N), whether only the first frames of a share were sent; None where none was.
        estimate_age_s: (R, S, N), age of each estimate when it was sent; None but in real time.
        duality_gap: (R, S, N), of sets that a programme found; None without.
        history: who took part when, in runs that were recorded; None for runs as arrays.
    """

    setup: Setup
    runs: np.ndarray
    links: tuple[np.ndarray, np.ndarray]
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
    readings: np.ndarray | None = None
    ages: np.ndarray | None = None
    cov: np.ndarray | None = None
    innovations: Innovations | None = None
    past: Past | None = None
    suspect: np.ndarray | None = None
    spreads: "tuple[RecordSpread, ...]" = ()
    extras: tuple[RunExtra, ...] = ()
    cut: np.ndarray | None = None
    estimate_age_s: np.ndarray | None = None
    duality_gap: np.ndarray | None = None
    history: History | None = None

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.truth.shape[1]

    @property
    def present(self) -> np.ndarray:
        """Which nodes took part and believe anything at all (R, S, N)."""
        believes = np.logical_not(np.asarray(np.isnan(self.mean).all(axis=-1)))
        if self.history is None:
            return believes
        return self.history.presence(*self.mean.shape[1:3])[None] & believes.any(
            axis=1, keepdims=True
        )

    def of(self, place: slice) -> "Runs":
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


def joined(parts: Sequence[Runs]) -> Runs:
    """Return the record of all runs of several records of one setup."""
    if len(parts) == 1:
        return parts[0]
    shapes = {name: (len(p.runs), p.setup.scenario.nodes) for p in parts for name in p.counters}
    counters = {
        name: np.concatenate([
            p.counters.get(name, np.zeros((len(p.runs), width), dtype=np.int64)) for p in parts
        ])
        for name, (_, width) in shapes.items()
    }  # fmt: skip
    if any(part.cut is not None for part in parts):
        parts = [p if p.cut is not None else p._replace(cut=np.zeros_like(p.asked)) for p in parts]
    names = {n for p in parts for n, one in p._asdict().items() if isinstance(one, np.ndarray)}
    whole = {
        name: None if any(one is None for one in each) else np.concatenate(each)
        for name, each in ((n, [getattr(part, n) for part in parts]) for n in sorted(names))
    }
    several = {
        name: None
        if one is None
        else type(one)(*map(np.concatenate, zip(*(getattr(p, name) for p in parts), strict=True)))
        for name, one in (("innovations", parts[0].innovations), ("past", parts[0].past))
    }
    return parts[0]._replace(
        **whole,
        **several,
        counters=counters,
        spreads=tuple(one for part in parts for one in part.spreads),
        extras=tuple(one for part in parts for one in part.extras),
    )


def runs_of_trace(setup: Setup, trace: "Trace", with_innovations: bool = True) -> Runs:
    """Return the record of one run from what its messages say."""
    drawn = {epoch.drawn_by for epoch in trace.history.epochs}
    graphs = [with_settings(setup, dict(one)).neighbours for one in drawn]
    nodes = range(setup.scenario.nodes)
    pairs = [(i, j) for i in nodes for j in sorted({j for graph in graphs for j in graph[i]})]
    receiver, sender = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    own = {name: None if one is None else one[None] for name, one in _arrays(trace).items()}
    names = sorted({name for counted in trace.counters for name in counted})
    readings = trace.readings[None]
    belief = Gaussian(trace.mean[None], trace.cov[None])
    return Runs(
        setup=setup,
        runs=np.array([setup.scenario.run]),
        links=(receiver, sender),
        cov_trace=np.trace(trace.cov, axis1=-2, axis2=-1)[None],
        nees=scored_nees(setup.scenario, trace.mean - trace.truth[:, None], trace.cov)[None],
        counters={n: np.array([[c.get(n, 0) for c in trace.counters]]) for n in names},
        prior_mean=np.array(setup.prior_mean)[None],
        ages=trace.ages[None, :, receiver, sender],
        innovations=innovations_of_nodes(
            setup, [setup.scenario.run], belief, readings, own["control"]
        )
        if with_innovations
        else None,
        past=trace.past and Past(*(one[None] for one in trace.past)),
        spreads=() if trace.spread is None else (trace.spread,),
        extras=() if trace.extra is None else (trace.extra,),
        cut=trace.cut[None] if trace.cut.any() else None,
        history=trace.history,
        **own,  # pyright: ignore[reportArgumentType]
    )


def _arrays(trace: "Trace") -> dict[str, np.ndarray | None]:
    """The arrays that the record has with the same axes, and one more before them."""
    names = (
        "truth", "control", "mean", "payload_bytes", "asked", "classes", "readings", "cov",
        "suspect", "estimate_age_s", "duality_gap",
    )  # fmt: skip
    return {name: getattr(trace, name) for name in names}
