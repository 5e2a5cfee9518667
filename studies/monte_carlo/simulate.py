"""Many runs of a scenario at once: `simulate` is where experiments get their Monte Carlo from.

    runs = simulate(prepare(scenario), range(200))
    errors = runs.mean - runs.truth[:, :, None]

Run r has the noise that `concord run --run r` has, and its numbers to 1e-10. Rules and scenarios
without an array form run message by message, one run after the other, and give the same value.
"""

import ctypes
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.messages import ReportedTracks
from concord.results.records.extras import Past, RunExtra, RunExtras, run_extras
from concord.results.records.runs import Runs, joined, runs_of_trace
from concord.runtime.batched.build import build_network, without_array_form
from concord.runtime.batched.driver import Instant, run
from concord.scenarios.catalogue import beside_truth, scored_nees
from concord.scenarios.innovations import Innovations, InnovationsByStep
from concord.scenarios.preparation import setup_of_run
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import MeasurementFlooding, smoothing_lags
from concord.scenarios.user.faults import user_faults
from concord.studies.monte_carlo.side_by_side import side_by_side

if TYPE_CHECKING:
    from concord.results.records.record_spread import RecordSpread
    from concord.results.records.spread_history import SpreadHistory

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # numbers of mallopt(3)
_KEPT_BYTES = 100_000_000


def keep_freed_memory() -> bool:
    """Let this process keep up to 100 MB of what it frees, instead of returning it page by page.

    Every temporary array of numpy above 128 kB is otherwise mapped, cleared and unmapped by the
    system, which takes longer than filling it: a batched filter step then costs two to six times as
    much. A process that computes many lanes calls this function once.

    Returns:
        Whether the C library can be told (glibc); elsewhere nothing happens.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_TRIM_THRESHOLD, _KEPT_BYTES) and mallopt(_MMAP_THRESHOLD, _KEPT_BYTES))


# Runs are taken so many at a time that this many nodes are computed at once: enough that numpy is
# worth its calls, little enough for caches and memory.
LANES = 2_048
# And no more than take some tens of seconds: what is interrupted keeps those that are complete.
LANE_STEPS = 12_000_000
# From so many nodes on two threads gain time, and runs are taken in an even number of parts.
_LANES_OF_TWO = 1_000

READINGS, AGES, COV, INNOVATIONS = "readings", "ages", "cov", "innovations"
OPTIONAL = frozenset((READINGS, AGES, COV, INNOVATIONS))
_PAST_MEAN, _PAST_STD = "past mean", "past std"
_INNOVATIONS = "innovation value", "innovation cov", "innovation nis"


class _Recorded(NamedTuple):
    """One step of some runs: the axes of `Runs` without S."""

    truth: np.ndarray
    control: np.ndarray | None
    belief: Gaussian
    payload_bytes: np.ndarray
    asked: np.ndarray
    classes: np.ndarray
    readings: np.ndarray
    ages: np.ndarray
    past: Past | None
    suspect: np.ndarray | None


@user_faults()
def simulate(
    setup: Setup,
    runs: Sequence[int],
    *,
    keep: Iterable[str] = (READINGS, AGES),
    on_progress: Callable[[int], None] = lambda done: None,
    threads: int = 1,
) -> Runs:
    """Run a setup under its seed with the noise of each of these run numbers.

    The numbers do not depend on `threads`, as the parts that runs are taken in do not.

    Args:
        setup: of any run; its own run number does not matter.
        runs: numbers of runs, at least one, each once.
        keep: which of `OPTIONAL` histories to keep beside means and traces: what the baselines need
            (readings), what held shares were worth (ages), full covariances (cov), innovations.
        on_progress: told how many steps of how many runs are done, added up.
        threads: compute so many parts at once; runs that pass messages take one.

    Raises:
        ValueError: no runs, or a name in `keep` that is none.
        UserFault: a function of the user failed in the run.
        Interrupted: by Ctrl-C, with the runs that were complete.
    """
    if not len(runs) or len(set(runs)) < len(runs):
        raise ValueError(f"runs {list(runs)[:9]}: give at least one number, each of them once")
    if unknown := set(keep) - OPTIONAL:
        raise ValueError(f"keep {sorted(unknown)}: choose from {sorted(OPTIONAL)}")
    keep_freed_memory()
    if without_array_form(setup.scenario) is not None:
        return _one_by_one(setup, runs, frozenset(keep), on_progress)
    collected = _Collected(setup, runs, frozenset(keep), on_progress)
    complete = 0
    try:
        for place in side_by_side(collected.take, _parts(setup.scenario, len(runs)), threads):
            complete = place.stop
    except KeyboardInterrupt:
        kept = collected.whole().of(slice(complete)) if complete else None
        raise Interrupted(kept) from None
    return collected.whole()


def _parts(scenario: Scenario, runs: int) -> list[slice]:
    """Return the places of runs that are taken at once, of equal size as far as they can be."""
    count = math.ceil(runs / runs_together(scenario))
    if count % 2 and runs > 1 and runs * scenario.nodes >= _LANES_OF_TWO:
        count += 1
    size = math.ceil(runs / count)
    return [slice(first, min(first + size, runs)) for first in range(0, runs, size)]


def _one_by_one(
    setup: Setup, runs: Sequence[int], keep: frozenset[str], on_progress: Callable[[int], None]
) -> Runs:
    parts: list[Runs] = []
    try:
        parts.extend(_by_messages(setup, runs, keep, on_progress))
    except KeyboardInterrupt:
        raise Interrupted(joined(parts) if parts else None) from None
    return joined(parts)


def runs_together(scenario: Scenario) -> int:
    """Return how many runs are taken at once."""
    if without_array_form(scenario) is not None:
        return 1
    lanes = min(LANES, LANE_STEPS // scenario.steps)
    return max(1, lanes // scenario.nodes)


class Interrupted(KeyboardInterrupt):
    """Interrupt of a simulation.

    `runs` are the first, complete ones; None if no run is complete.
    """

    def __init__(self, runs: Runs | None) -> None:
        super().__init__()
        self.runs = runs


class _Collected:
    """The histories of some runs, as they come to be known."""

    def __init__(
        self,
        setup: Setup,
        runs: Sequence[int],
        keep: frozenset[str],
        on_progress: Callable[[int], None],
    ) -> None:
        self._setup, self._runs, self._keep, self._on_progress = setup, runs, keep, on_progress
        # Threads take parts of the runs: arrays are made and counts are added by one at a time.
        self._lock = threading.Lock()
        self._arrays: dict[str, np.ndarray] = {}
        self._counters: dict[str, np.ndarray] = {}
        self._prior_mean = np.empty((len(runs), len(setup.prior_mean)))
        self._spreads: dict[int, Sequence[RecordSpread]] = {}
        self._extras: dict[int, Sequence[RunExtra]] = {}
        self._done = 0

    def take(self, place: slice, go_on: Callable[[], None]) -> None:
        """Run those of a place, and keep their results; call `go_on` after each step."""
        setup, runs = self._setup, self._runs[place]
        part = _driven(setup, runs)
        self._prior_mean[place] = part.prior_mean
        innovations = InnovationsByStep(setup, runs) if INNOVATIONS in self._keep else None
        for step, recorded in enumerate(part.steps):
            at = (place, step)
            self._put(at, _values(setup, recorded, self._keep))
            if innovations is not None:
                self._put_innovations(at, innovations, recorded)
            with self._lock:
                self._done += len(runs)
                self._on_progress(self._done)
            go_on()
        with self._lock:
            for name, counts in part.counters.items():
                shape = (len(self._runs), setup.scenario.nodes)
                self._counters.setdefault(name, np.zeros(shape, dtype=np.int64))[place] = counts
            self._spreads[place.start] = part.spreads()
            self._extras[place.start] = part.extras()

    def _put_innovations(
        self, at: tuple[slice, int], innovations: InnovationsByStep, recorded: _Recorded
    ) -> None:
        found = innovations.add(recorded.belief, recorded.readings, recorded.control)
        if found is not None:
            self._put(at, dict(zip(_INNOVATIONS, found, strict=True)))

    def _put(self, at: tuple[slice, int], values: Mapping[str, np.ndarray | None]) -> None:
        """Put values of one step of some runs in their place, `at` (which runs, step), but what is
        None."""
        place, step = at
        for name, value in values.items():
            if value is not None:
                self._array(name, value, step)[place, step] = value

    def _array(self, name: str, like: np.ndarray, step: int) -> np.ndarray:
        with self._lock:
            if name not in self._arrays:
                shape = (len(self._runs), self._setup.scenario.steps, *like.shape[1:])
                self._arrays[name] = np.empty(shape, like.dtype)
                if step:
                    # Nothing drives the plant into the first step.
                    self._arrays[name][:, :step] = np.nan
            return self._arrays[name]

    def whole(self) -> Runs:
        """Of all runs; of those that were not taken, no number means anything."""
        missing = dict.fromkeys(OPTIONAL | {"control", "suspect"})
        del missing[INNOVATIONS]
        arrays = dict(self._arrays)
        past = Past(arrays.pop(_PAST_MEAN), arrays.pop(_PAST_STD)) if _PAST_MEAN in arrays else None
        there = _INNOVATIONS[0] in arrays
        innovations = Innovations(*map(arrays.pop, _INNOVATIONS)) if there else None
        fields: dict[str, Any] = {**missing, **arrays}
        return Runs(
            setup=self._setup,
            runs=np.array(self._runs),
            links=self._setup.links,
            counters=self._counters,
            prior_mean=self._prior_mean,
            innovations=innovations,
            past=past,
            spreads=_in_order(self._spreads),
            extras=_in_order(self._extras),
            **fields,
        )


def _in_order(parts: Mapping[int, Sequence[Any]]) -> tuple[Any, ...]:
    return tuple(value for first in sorted(parts) for value in parts[first])


class _Part(NamedTuple):
    """Some runs: their steps, counters that are filled as the steps are taken, where they begin,
    and once all steps are taken, how records spread, and what nodes told beside their beliefs."""

    steps: Iterable[_Recorded]
    counters: dict[str, np.ndarray]
    prior_mean: np.ndarray
    spreads: "Callable[[], Sequence[RecordSpread]]"
    extras: Callable[[], Sequence[RunExtra]]


def _driven(setup: Setup, runs: Sequence[int]) -> _Part:
    """Some runs at once."""
    network = build_network(setup, runs)
    most_rounds = max(segment.settings.rounds for segment in network.segments)
    counters: dict[str, np.ndarray] = {}
    # Nodes times nodes times steps: nothing that a rule without records could afford.
    spreads: list[SpreadHistory] = []
    extras = run_extras(setup.scenario)
    told = None if extras is None else _Told(setup, extras, len(runs))

    def steps() -> Iterable[_Recorded]:
        for instant in run(network):
            counters.update(instant.counters)
            if told is not None:
                told.add(instant)
            elif instant.spread is not None and not setup.scenario.changes:
                # Only here: other rules have no records.
                from concord.results.records.spread_history import SpreadHistory

                spreads[:] = spreads or [SpreadHistory(setup, len(runs))]
                spreads[0].add(instant)
            yield _recorded(setup, instant, most_rounds)

    return _Part(
        steps(),
        counters,
        network.prior.mean[:, 0],
        lambda: spreads[0].of_runs() if spreads else (),
        tuple if told is None else told.of_runs,
    )


class _Told:
    """Messages of R runs beside beliefs, and the states of their plants."""

    def __init__(self, setup: Setup, extras: RunExtras, runs: int) -> None:
        self._setup, self._extras = setup, extras
        self._truth: list[np.ndarray] = []
        self._told: list[dict[tuple[int, int], ReportedTracks | None]] = [{} for _ in range(runs)]

    def add(self, instant: Instant) -> None:
        """One step more."""
        self._truth.append(instant.truth)
        for told, of_run in zip(self._told, instant.tracks or (), strict=True):
            told.update({(instant.step, node): one for node, one in enumerate(of_run)})

    def of_runs(self) -> list[RunExtra]:
        """Return the value of each run after its last step."""
        runs = zip(np.stack(self._truth, axis=1), self._told, strict=True)
        return [self._extras.read(self._setup, *one) for one in runs]


def _recorded(setup: Setup, instant: Instant, rounds: int) -> _Recorded:
    lacking = ((0, rounds - len(instant.payload_bytes)), (0, 0), (0, 0))
    payload, asked, classes = (
        np.pad(one, lacking).transpose(1, 0, 2)
        for one in (instant.payload_bytes, instant.asked, instant.classes)
    )
    # The plant of nodes that tell tracks has more states than a belief, which come first.
    truth = instant.truth if instant.tracks is None else instant.truth[:, : len(setup.prior_mean)]
    mean, cov = instant.belief
    return _Recorded(
        truth,
        instant.control,
        Gaussian(beside_truth(setup.scenario, mean, truth[:, None]), cov),
        payload,
        asked,
        classes,
        instant.readings,
        instant.ages,
        _past(instant, smoothing_lags(setup.scenario.rule)),
        _suspect(setup, instant),
    )


def _suspect(setup: Setup, instant: Instant) -> np.ndarray | None:
    """Which nodes are suspect (R, N); none while another rule is set."""
    if not isinstance(setup.scenario.rule, MeasurementFlooding):
        return None
    nobody = np.zeros(instant.belief.mean.shape[:2], dtype=bool)
    return nobody if instant.suspect is None else instant.suspect


def _past(instant: Instant, lags: int) -> Past | None:
    """The smoothed states (R, L, N, n) of a step; NaN while another rule is set."""
    if not lags:
        return None
    if instant.past is None:
        runs, nodes, n = instant.belief.mean.shape
        nothing = np.full((runs, lags, nodes, n), np.nan)
        return Past(nothing, nothing)
    std = np.sqrt(np.diagonal(instant.past.cov, axis1=-2, axis2=-1))
    return Past(instant.past.mean.swapaxes(1, 2), std.swapaxes(1, 2))


def _by_messages(
    setup: Setup, runs: Sequence[int], keep: frozenset[str], on_progress: Callable[[int], None]
) -> Iterator[Runs]:
    """The runs one after the other, message by message."""
    # Only here: runs as arrays pass no messages.
    from concord.results.records.trace import read_trace
    from concord.runtime.drivers import in_memory

    for done, run_number in enumerate(runs, 1):
        own = setup_of_run(setup, run_number)
        found = runs_of_trace(own, read_trace(own, in_memory(own)), INNOVATIONS in keep)
        on_progress(done * setup.scenario.steps)
        yield found._replace(
            setup=setup,
            history=None,
            **{name: None for name in OPTIONAL - keep},
        )


def _values(
    setup: Setup, recorded: _Recorded, keep: frozenset[str]
) -> dict[str, np.ndarray | None]:
    """Return the histories that one step of some runs adds to, by name; None for those without."""
    belief, truth = recorded.belief, recorded.truth
    return {
        "truth": truth,
        "control": recorded.control,
        "mean": belief.mean,
        "cov_trace": np.trace(belief.cov, axis1=-2, axis2=-1),
        "nees": scored_nees(setup.scenario, belief.mean - truth[:, None], belief.cov),
        "payload_bytes": recorded.payload_bytes.astype(np.int32),
        "asked": recorded.asked,
        "classes": recorded.classes.astype(np.int16),
        READINGS: recorded.readings if READINGS in keep else None,
        AGES: recorded.ages.astype(np.int32) if AGES in keep else None,
        COV: belief.cov if COV in keep else None,
        "suspect": recorded.suspect,
        _PAST_MEAN: None if recorded.past is None else recorded.past.mean,
        _PAST_STD: None if recorded.past is None else recorded.past.std,
    }
