"""Bus report of a run: frames in microseconds, load, delay, starvation, ages of shares.

All values follow from the slot table and the publishers of each cycle, so plans and runs have the
same report.
"""

from collections.abc import Sequence
from math import isnan, nan

import msgspec
import numpy as np

from concord.bus.bus import Bus, Transmission, retransmits
from concord.results.bus.bus_times import (
    cycle_numbers,
    delays_us,
    has_times,
    on_the_wire,
    shares_of,
    timetable,
)
from concord.results.bus.sent_shares import SentShares
from concord.results.records.runs import Runs
from concord.scenarios.build import build_bus


class BusFigures(msgspec.Struct, frozen=True):
    """Bus figures of a run.

    The bus goes on between the steps, in cycles that carry no round. Figures are of the cycles that
    carry rounds; those whose name ends in `_all` are of all cycles of the run.

    Attributes:
        cycles, cycles_all: how many.
        bus_load, bus_load_max: share of a cycle in which the busier channel carries frames.
        channel_loads: mean share of a cycle in which each channel carries frames.
        bytes_per_step, wire_us_per_step: of all frames with their headers, checksums and
            padding, and how long they keep the bus busy.
        error_frames: tries of frames that ended in an error, on a bus that sends them again;
            `error_us_per_step` is their time, with the tries themselves.
        delay_us, delay_us_max: from a measurement to the last share of its step; `wait_us_max`
            of it is the longest wait for the step's first cycle.
        worst_access_us: bound from the request of a share at any moment to its last bit, whatever
            the other nodes send; None for a bus that states none.
        contenders: nodes that asked for the dynamic segment; `starved` of them never got it.
        cut_shares: shares of which only the first frames were sent; no node can use them.
        ideal_arbiter: no controller awards slots in the order in which they got it.
        has_minislots: the bus counts minislots.
        empty_minislots_mean, empty_minislots_max: minislots of a cycle in which no node sent, up to
            the last frame: the price of frame IDs that are not used.
        longest_wait_cycles: most contended cycles in a row in which `longest_wait_node` asked in
            vain; None where nobody ever did. `longest_wait_all`: the longest such time of any node.
        share_ages: how many of the neighbours' shares behind the estimates were 0, 1, 2, ... cycles
            old after the last round of a step; `never_heard` were not there yet.
        share_age_median_all, share_age_max_all: of the same ages; NaN and -1 where there are none.
    """

    cluster: str
    cycle_us: float
    cycles: int
    cycles_all: int
    frames: int
    frames_per_cycle_mean: float
    frames_per_cycle_max: int
    frames_per_cycle_all: float
    bus_load: float
    bus_load_max: float
    channel_loads: dict[str, float]
    bus_load_all: float
    bytes_per_step: float
    wire_us_per_step: float
    error_frames: int
    error_us_per_step: float
    delay_us: float
    delay_us_max: float
    wait_us_max: float
    worst_access_us: float | None
    contenders: int
    ideal_arbiter: bool
    starved: list[int]
    cut_shares: int
    has_minislots: bool
    empty_minislots_mean: float
    empty_minislots_max: int
    longest_wait_cycles: int
    longest_wait_all: int
    longest_wait_node: int | None
    share_ages: list[int]
    share_age_median_all: float
    share_age_max_all: int
    never_heard: int


def figures_of(runs: Runs) -> BusFigures | None:
    """The figures of one run's bus; None where the bus has no time, or was another in the run."""
    bus, sender = build_bus(runs.setup), runs.links[1]
    if not has_times(bus, runs):
        return None
    assert runs.ages is not None, "keep the ages"
    tables = (*bus.schedule.static_table, *bus.schedule.contender_table)
    publishers = {node for row in tables for node in row}
    heard = runs.ages[0][:, np.isin(sender, sorted(publishers))]
    errors = runs.counters.get("error frame", np.zeros((1, runs.setup.scenario.nodes), int))
    return bus_figures(bus, shares_of(runs), runs.asked[0], heard, errors[0].tolist())


def bus_figures(
    bus: Bus,
    shares: SentShares,
    asked: np.ndarray,
    ages: np.ndarray,
    errors: Sequence[int] = (),
) -> BusFigures:
    """Return the figures of a bus with time.

    `shares` (steps, rounds, N) were sent, `asked` tells who asked for the dynamic segment; `ages`
    (steps, any) are those of the shares behind the estimates, -1 where there was none. `errors`
    (N,): tries of each node's frames that ended in an error.
    """
    cycles, timebase = timetable(bus, shares), bus.timebase
    steps, rounds, nodes = shares.payload_bytes.shape
    cycles_all = timebase.cycles_of(steps)
    ages_all = timebase.ages_over_all(ages)[ages >= 0]
    frames = [len(cycle) for cycle in cycles]
    load = [bus.load(cycle) for cycle in cycles]
    delay_us = delays_us(
        bus, cycles if shares.cut is None else timetable(bus, shares.whole), rounds
    )
    sent_frames = [frame for cycle in cycles for frame in cycle]
    bytes_per_step, wire_us_per_step = on_the_wire(bus, sent_frames, len(cycles) / rounds)
    asked, sent = asked.reshape(-1, nodes), shares.whole.payload_bytes.reshape(-1, nodes) > 0
    waits, waits_all = longest_waits(asked, sent, cycle_numbers(bus, len(cycles)))
    empty = [empty_minislots(cycle) for cycle in cycles]
    starved = np.flatnonzero(asked.any(axis=0) & ~(asked & sent).any(axis=0))
    return BusFigures(
        cluster=bus.name,
        cycle_us=bus.cycle_us,
        cycles=len(cycles),
        cycles_all=round(cycles_all),
        frames=sum(frames),
        frames_per_cycle_mean=float(np.mean(frames)),
        frames_per_cycle_max=max(frames),
        frames_per_cycle_all=sum(frames) / cycles_all,
        bus_load=float(np.mean(load)),
        bus_load_max=max(load),
        channel_loads=_channel_loads(bus, sent_frames, len(cycles)),
        bus_load_all=sum(load) / cycles_all,
        bytes_per_step=bytes_per_step,
        wire_us_per_step=wire_us_per_step,
        error_frames=sum(errors),
        error_us_per_step=_errors_us(bus, sent_frames, errors) / steps,
        delay_us=float(np.mean(delay_us)),
        delay_us_max=max(delay_us),
        wait_us_max=max(timebase.wait_us(step) for step in range(steps)),
        worst_access_us=None if isnan(bus.worst_access_us) else bus.worst_access_us,
        contenders=int(asked.any(axis=0).sum()),
        ideal_arbiter=bus.has_ideal_arbiter,
        starved=starved.tolist(),
        cut_shares=0 if shares.cut is None else int(shares.cut.sum()),
        has_minislots=bool(bus.marks_us()[1]),
        empty_minislots_mean=float(np.mean(empty)),
        empty_minislots_max=max(empty),
        longest_wait_cycles=int(waits.max()),
        longest_wait_all=int(waits_all.max()),
        longest_wait_node=int(waits.argmax()) if waits.any() else None,
        share_ages=np.bincount(ages[ages >= 0]).tolist(),
        share_age_median_all=float(np.median(ages_all)) if len(ages_all) else nan,
        share_age_max_all=int(ages_all.max(initial=-1)),
        never_heard=int((ages < 0).sum()),
    )


def _errors_us(bus: Bus, frames: Sequence[Transmission], errors: Sequence[int]) -> float:
    """Return the time of failed tries; those of a node last as long as its frames on average."""
    if not (retransmits(bus) and any(errors)):
        return 0.0
    total_us = 0.0
    for node, count in enumerate(errors):
        if count:
            own = [bus.failed_us(one.payload_bytes) for one in frames if one.node == node]
            total_us += count * float(np.mean(own))
    return total_us


def _channel_loads(bus: Bus, frames: Sequence[Transmission], cycles: int) -> dict[str, float]:
    busy_us = dict.fromkeys(bus.channels, 0.0)
    for frame in frames:
        for channel in frame.channel:
            busy_us[channel] += frame.end_us - frame.start_us
    return {channel: busy / cycles / bus.cycle_us for channel, busy in busy_us.items()}


def longest_waits(
    asked: np.ndarray, sent: np.ndarray, numbers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Per node (N,): most cycles in a row in which it asked and did not send, and the most cycles
    of the bus from the first to the last of such a row.

    `asked`, `sent` are (cycles, N), `numbers` (cycles,) those of the cycles on the bus. Cycles in
    which nobody asks have no dynamic segment, and do not count in a row.
    """
    contested = asked.any(axis=1)
    wait = longest = longest_all = np.zeros(asked.shape[1], dtype=np.int64)
    since = wait
    for number, wanted, got in zip(
        numbers[contested].tolist(), asked[contested], sent[contested], strict=True
    ):
        in_vain = wanted & ~got
        since = np.where(wait > 0, since, number)
        wait = np.where(in_vain, wait + 1, 0)
        longest = np.maximum(longest, wait)
        longest_all = np.maximum(longest_all, np.where(in_vain, number - since + 1, 0))
    return longest, longest_all


def empty_minislots(cycle: Sequence[Transmission]) -> int:
    """Return the minislots of a cycle in which no node sent, up to the last frame; of channels that
    count apart, the most of one."""
    of_channel: dict[str, list[tuple[int, int]]] = {}
    for one in cycle:
        if one.minislot:
            of_channel.setdefault(one.channel, []).append((one.minislot, one.frame_id))
    return max(map(_empty, of_channel.values()), default=0)


def _empty(frames: Sequence[tuple[int, int]]) -> int:
    (first_minislot, first_id), (_, last_id) = min(frames), max(frames)
    return first_minislot - 1 + last_id - first_id - (len(frames) - 1)


def lines(figures: BusFigures) -> list[str]:
    """Return the figures in words."""
    ages = np.repeat(np.arange(len(figures.share_ages)), figures.share_ages)
    text = [
        f"bus {figures.cluster}: {figures.frames_per_cycle_mean:.1f} frames in a cycle of "
        f"{figures.cycle_us / 1e3:.4g} ms (most {figures.frames_per_cycle_max}), load "
        f"{100 * figures.bus_load:.1f} % (most {100 * figures.bus_load_max:.1f} %"
        f"{_of_channels(figures.channel_loads)}), measurement to "
        f"estimate {figures.delay_us / 1e3:.4g} ms (most {figures.delay_us_max / 1e3:.4g} ms)",
        f"rounds use {figures.cycles} of the {figures.cycles_all} cycles that pass on the bus: "
        f"over all of them {figures.frames_per_cycle_all:.3g} frames in a cycle, load "
        f"{100 * figures.bus_load_all:.3g} %; a step waits up to "
        f"{figures.wait_us_max / 1e3:.4g} ms for its first cycle",
        f"on the wire {figures.bytes_per_step:.0f} bytes and {figures.wire_us_per_step:.0f} "
        "us per step",
    ]
    if figures.error_frames:
        text.append(
            f"errors: {figures.error_frames} tries of frames failed and were sent again or given "
            f"up; they take {figures.error_us_per_step:.0f} us more per step"
        )
    if figures.worst_access_us is not None:
        text.append(
            f"worst access {figures.worst_access_us / 1e3:.4g} ms: from the request of a share at "
            "any moment to its last bit, with all other nodes sending"
        )
    if len(ages):
        known = len(ages) + figures.never_heard
        unheard = f", {100 * figures.never_heard / known:.1f} % never heard"
        text.append(
            f"shares in estimates: {100 * figures.share_ages[0] / known:.0f} % fresh, median age "
            f"{np.median(ages):g} cycles, oldest {ages[-1]} (of all cycles "
            f"{figures.share_age_median_all:g} and {figures.share_age_max_all})"
            f"{unheard if figures.never_heard else ''}"
        )
    if figures.contenders:
        empty = (
            f"; {figures.empty_minislots_mean:.0f} empty minislots before the last frame of a "
            f"cycle (most {figures.empty_minislots_max})"
        )
        text.append(
            f"dynamic segment: {figures.contenders} contenders"
            f"{' (ideal arbiter)' if figures.ideal_arbiter else ''}, {starvation(figures)}"
            f"{empty if figures.has_minislots else ''}"
        )
    if figures.cut_shares:
        text.append(
            f"cut: of {figures.cut_shares} shares only the first frames were sent, which no node "
            "can use; hosts that withdraw such shares (--withdrawal) leave the bus free"
        )
    return text


def _of_channels(loads: dict[str, float]) -> str:
    if len(loads) == 1:
        return ""
    return "; " + ", ".join(f"{name} {100 * load:.1f} %" for name, load in loads.items())


def starvation(figures: BusFigures) -> str:
    """Return the waits of nodes for the dynamic segment, in words."""
    if figures.longest_wait_node is None:
        return "nobody asked in vain"
    cycles = figures.longest_wait_cycles
    wait = (
        f"longest wait {cycles} cycle{'s' * (cycles > 1)} (node {figures.longest_wait_node}), "
        f"{figures.longest_wait_all} of all cycles"
    )
    if not figures.starved:
        return f"{wait}, nobody starved"
    return f"{wait}, starved (never sent): nodes {', '.join(map(str, figures.starved))}"
