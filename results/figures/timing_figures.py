"""How well a run in real time kept its time, from what its nodes said of every step."""

from collections.abc import Iterable, Sequence
from itertools import zip_longest

import msgspec
import numpy as np

from concord.nodes.changes import Event
from concord.nodes.history import History, history_of
from concord.nodes.messages import Grant, Timing
from concord.nodes.tempo import Tempo
from concord.runtime.recorded import message_of


class TimingSpread(msgspec.Struct, frozen=True):
    """Of what was timed at all nodes and steps, in milliseconds."""

    p50_ms: float
    p99_ms: float
    largest_ms: float


class TimingFigures(msgspec.Struct, frozen=True):
    """Deadlines of a run, and how well the run met them.

    `cycles` are counted at each node. `deadline_misses` is the sum of two counts: `incomplete`
    cycles ended without an expected message, `overrun` cycles began after their own deadline.
    `late_shares` came after their cycle, `late_percent` of all that came;
    `late_bids` came after the environment had granted the
    slots. `lost_heartbeats` counts steps that began without readings. `skips` counts how often a
    node was far behind and left out the steps between. `cycle_jitter` is the
    lateness of cycle starts, `heartbeat` the lateness of readings. `delay` is the age of estimates
    when they are sent, from the sampling instant on, and at most `delay_limit_ms`. `age` is the age
    that estimates of members reached before the next ones came.
    """

    cycle_stretch: float
    cycle_ms: float
    step_ms: float
    cycles: int
    deadline_misses: int
    incomplete: int
    overrun: int
    late_shares: int
    late_percent: float
    late_bids: int
    cycle_jitter: TimingSpread
    heartbeat: TimingSpread
    lost_heartbeats: int
    skips: int
    delay: TimingSpread
    delay_limit_ms: float
    age: TimingSpread


def figures_of(
    tempo: Tempo,
    messages: Iterable[tuple[str, bytes]],
    counters: Sequence[dict[str, int]],
    sent_age_s: np.ndarray | None,
) -> TimingFigures:
    """The figures of recorded (topic, bytes), of a step at least, of each node's counters, and of
    the ages (steps, N) of estimates when they were sent; None for unknown."""
    kinds = ("grant", "event", "timing")
    wanted = (one for one in messages if one[0].partition("/")[0] in kinds)
    read = [message_of(*one, len(counters)) for one in wanted]
    said = [one for one in read if isinstance(one, Timing)]
    grants = [one for one in read if isinstance(one, Grant)]
    history = history_of(1, [one for one in read if isinstance(one, Event)])
    sent_s = np.empty((0, len(counters))) if sent_age_s is None else sent_age_s
    incomplete = sum(timing.incomplete for timing in said)
    overrun = sum(timing.overrun for timing in said)
    came = [late for timing in said if (late := timing.heartbeat_late_s) is not None]
    late = [late_s for timing in said for late_s in timing.cycle_late_s]
    late_frames, heard = (sum(c.get(name, 0) for c in counters) for name in ("late", "heard"))
    return TimingFigures(
        cycle_stretch=tempo.stretch,
        cycle_ms=tempo.cycle_s * 1e3,
        step_ms=tempo.step_s * 1e3,
        cycles=len(late),
        deadline_misses=incomplete + overrun,
        incomplete=incomplete,
        overrun=overrun,
        late_shares=late_frames,
        late_percent=100 * late_frames / max(late_frames + heard, 1),
        late_bids=sum(len(grant.unheard) for grant in grants if grant.unheard),
        cycle_jitter=_spread(late),
        heartbeat=_spread(came),
        lost_heartbeats=len(said) - len(came),
        skips=sum(c.get("skipped ahead", 0) for c in counters),
        delay=_spread(sent_s[np.isfinite(sent_s)]),
        delay_limit_ms=tempo.oldest_s * 1e3,
        age=_spread(peak_ages_s(sent_s, history, tempo.step_s)),
    )


def peak_ages_s(sent_age_s: np.ndarray, history: History, step_s: float) -> np.ndarray:
    """Return the age that each estimate reached before the next one of its node replaced it.

    This is the peak age of information (Costa, Codreanu and Ephremides, IEEE Transactions on
    Information Theory 62(4), 2016). The age of an estimate ends when its node leaves the network,
    or with the run: other nodes know that a node is out.

    Args:
        sent_age_s: (steps, N), age of each estimate when it was sent; NaN where none came.
        history: which nodes took part in which step, as the events of the run say.
        step_s: from one sampling instant to the next.
    """
    steps, nodes = sent_age_s.shape
    peaks = []
    for node in range(nodes):
        came = np.flatnonzero(np.isfinite(sent_age_s[:, node])).tolist()
        ends = [absent.first_step for absent in history.absent_steps if absent.node == node]
        for step, following in zip_longest(came, came[1:]):
            end = min([end for end in ends if end > step], default=steps)
            if following is None or end <= following:
                peaks.append((end - step) * step_s)
            else:
                peaks.append((following - step) * step_s + sent_age_s[following, node])
    return np.array(peaks)


def _spread(times_s: Sequence[float] | np.ndarray) -> TimingSpread:
    if len(times_s) == 0:
        return TimingSpread(np.nan, np.nan, np.nan)
    middle, high, largest = np.quantile(times_s, [0.5, 0.99, 1.0]) * 1e3
    return TimingSpread(float(middle), float(high), float(largest))


def lines(figures: TimingFigures) -> list[str]:
    """The figures in words."""
    return [
        f"real time: a cycle every {figures.cycle_ms:.3g} ms ({figures.cycle_stretch:.3g} x the "
        f"bus's), a step every {figures.step_ms:.4g} ms",
        f"deadline misses {figures.deadline_misses} of {figures.cycles} cycles "
        f"({figures.incomplete} lacked something, {figures.overrun} began too late); "
        f"late shares {figures.late_shares} "
        f"({figures.late_percent:.2g} %), bids {figures.late_bids}; steps without readings "
        f"{figures.lost_heartbeats}; skips of nodes far behind {figures.skips}",
        f"p50/p99/largest in ms: cycles begin {_words(figures.cycle_jitter)} late, readings come "
        f"{_words(figures.heartbeat)} late, measurement to estimate {_words(figures.delay)} (limit "
        f"{figures.delay_limit_ms:.4g}), age until the next estimate {_words(figures.age)}",
    ]


def _words(spread: TimingSpread) -> str:
    return f"{spread.p50_ms:.3g}/{spread.p99_ms:.3g}/{spread.largest_ms:.3g}"
