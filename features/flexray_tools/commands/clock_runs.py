"""`concord flexray clocks`: cold start and clock synchronisation of a cluster."""

import math
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import tyro
from rich.table import Table

from concord.bus.flexray.clocks.controller_states import PocState
from concord.bus.flexray.clocks.settings import ClockSettings, clock_settings
from concord.disk import writing
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.clocks.clock_run import (
    ClockRun,
    Conditions,
    draw_conditions,
    run_clocks,
)
from concord.features.flexray_tools.commands.clusters import read_cluster


def draw(spreads_us: np.ndarray, bound_us: float, out: Path) -> None:
    """Write a picture of the largest difference of two active nodes' clocks in each cycle.

    Args:
        spreads_us: (cycles,). bound_us: the assumed precision.
    """
    # Only here: most runs of the command draw nothing.
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.plot(np.arange(1, len(spreads_us) + 1), spreads_us, linewidth=0.7, label="reached")
    axes.axhline(bound_us, color="black", linestyle="--", label="assumed precision")
    axes.set(
        xscale="log",
        xlabel="communication cycle since the first collision avoidance symbol",
        ylabel="largest difference of two clocks (us)",
        ylim=(0, None),
    )
    axes.legend()
    with writing(out):
        figure.savefig(out)
    plt.close(figure)


_PICTURES = (".png", ".svg", ".pdf")
_MOST_NODES, _MOST_CYCLES, _MOST_PPM = 2047, 1_000_000, 10_000.0
_STATES = {
    PocState.ACTIVE: "normal active",
    PocState.PASSIVE: "normal passive",
    PocState.HALT: "halt",
}


class NodeClock(msgspec.Struct, frozen=True):
    """A node at the end of a run. `active_from` counts cycles from the first collision avoidance
    symbol until it was normal active, None if it never was."""

    node: int
    role: str
    ppm: float
    active_from: int | None
    rate_correction_microticks: int
    state: str


class ClockReport(msgspec.Struct, frozen=True):
    """Result of `concord flexray clocks`; times in microseconds, corrections in microticks."""

    cluster: str
    nodes: list[NodeClock]
    sync_nodes: int
    startup_nodes: int
    lying_sync_nodes: int
    cycles: int
    leader: int
    collided: list[int]
    attempts: int
    precision_us: float
    bound_us: float
    action_point_us: float
    largest_rate_correction: int
    rate_correction_limit: int
    largest_offset_correction: int
    offset_correction_limit: int


def clocks(
    cluster: tyro.conf.Positional[str],
    /,
    *,
    name: str | None = None,
    nodes: int = 20,
    drift: str = "1500",
    cycles: int = 10_000,
    power_on_cycles: float = 1.0,
    liars: int = 0,
    seed: int = 1,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
) -> None:
    """Start a cluster from cold, and run it with clocks that deviate.

    Args:
        cluster: A preset, or a file: TOML, FIBEX (.xml) or AUTOSAR (.arxml).
        name: Which cluster of a FIBEX or AUTOSAR file that has several.
        nodes: Number of nodes. The first ones send sync frames.
        drift: Deviation of the clocks in millionths. One number is a limit: each clock is drawn
            between minus and plus it. Several numbers (100,-20,...) are the clocks of the nodes.
        cycles: Communication cycles from the first collision avoidance symbol.
        power_on_cycles: The nodes are switched on within so many cycles.
        liars: Number of sync nodes whose frames come to each receiver at another time.
        seed: Of clocks, places, times of power-on and lies.
        out: Picture to write (.png, .svg, .pdf): the precision in each cycle.
        json: Print one JSON object.
    """
    with user_errors():
        read = read_cluster(cluster, name)
        _check(nodes, cycles, power_on_cycles, out)
        if seed < 0:
            raise ValueError(f"--seed is {seed}, but must be 0 or more")
        settings = clock_settings(read, nodes)
        if not 0 <= liars < len(settings.sync):
            raise ValueError(
                f"--liars is {liars}, but cluster {read.name!r} has {len(settings.sync)} sync "
                f"nodes; choose from 0 to {len(settings.sync) - 1}"
            )
        rates = _rates(drift, nodes)
        conditions = draw_conditions(nodes, rates, power_on_cycles, seed, liars)
        run = run_clocks(settings, conditions, cycles, seed)
    report = _report(read.name, settings, conditions, run)
    if out is not None:
        draw(run.spreads_us, settings.precision_us, out)
    if json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
        return
    plain_console().print(_table(report))
    sys.stdout.writelines(f"{line}\n" for line in _sentences(report))


def _check(nodes: int, cycles: int, power_on_cycles: float, out: Path | None) -> None:
    for option, value, least, most in (
        ("--nodes", nodes, 2, _MOST_NODES),
        ("--cycles", cycles, 1, _MOST_CYCLES),
        ("--power-on-cycles", power_on_cycles, 0, 1000),
    ):
        if not least <= value <= most:
            raise ValueError(f"{option} is {value}, but must be from {least} to {most}")
    if out is not None and out.suffix.lower() not in _PICTURES:
        raise ValueError(f"--out {out}: a picture ends in {', '.join(_PICTURES)}; rename it")
    if out is not None and not out.parent.is_dir():
        raise ValueError(f"--out {out}: no such folder {out.parent}; make it first")


def _rates(text: str, nodes: int) -> float | np.ndarray:
    """One limit, or the deviation of each node."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(
            f"--drift is {text!r}, but must be one number, or one for each node with commas"
        ) from None
    if any(not math.isfinite(one) or abs(one) > _MOST_PPM for one in numbers):
        raise ValueError(
            f"--drift is {text!r}, but clocks deviate by {-_MOST_PPM:g} to {_MOST_PPM:g} millionths"
        )
    if len(numbers) == 1:
        return numbers[0]
    if len(numbers) != nodes:
        raise ValueError(
            f"--drift has {len(numbers)} numbers, but there are {nodes} nodes; give one limit, or "
            "a number for each node"
        )
    return np.array(numbers)


def _report(
    cluster: str, settings: ClockSettings, conditions: Conditions, run: ClockRun
) -> ClockReport:
    roles = {one.node: "following" if one.starts else "sync" for one in settings.sync}
    roles[run.start.leader] = "leading"
    state = run.network.controllers.state.tolist()
    active_from = run.start.active_from.tolist()
    rows = [
        NodeClock(
            node,
            roles.get(node, "other"),
            float(conditions.ppm[node]),
            active_from[node] if active_from[node] >= 0 else None,
            int(run.network.timing.rate[node]),
            _STATES.get(state[node], "not integrated"),
        )
        for node in range(len(state))
    ]
    return ClockReport(
        cluster=cluster,
        nodes=rows,
        sync_nodes=len(settings.sync),
        startup_nodes=int(settings.starters.sum()),
        lying_sync_nodes=len(conditions.liars),
        cycles=len(run.spreads_us),
        leader=run.start.leader,
        collided=list(run.start.collided),
        attempts=run.start.attempts,
        precision_us=run.precision_us,
        bound_us=settings.precision_us,
        action_point_us=settings.window * settings.microtick_us,
        largest_rate_correction=run.largest_rate,
        rate_correction_limit=settings.rate_limit,
        largest_offset_correction=run.largest_offset,
        offset_correction_limit=settings.offset_limit,
    )


def _table(report: ClockReport) -> Table:
    grid = Table("node", "role", "drift ppm", "active from", "rate correction", "state")
    grid.show_edge = False
    for row in report.nodes:
        grid.add_row(
            str(row.node),
            row.role,
            f"{row.ppm:.1f}",
            "never" if row.active_from is None else f"cycle {row.active_from}",
            str(row.rate_correction_microticks),
            row.state,
        )
    return grid


def _sentences(report: ClockReport) -> list[str]:
    said = [
        f"cluster {report.cluster}: {len(report.nodes)} nodes, {report.sync_nodes} send sync "
        f"frames, {report.startup_nodes} of them start the cluster"
    ]
    if len(report.collided) > 1:
        nodes = ", ".join(str(node) for node in report.collided)
        said.append(f"collision: nodes {nodes} began at once, and node {report.leader} won")
    counts = {
        role: [row.active_from for row in report.nodes if row.role == role and row.active_from]
        for role in ("leading", "following", "sync", "other")
    }
    reached = [f"{role} {_cycles(found)}" for role, found in counts.items() if found]
    attempts = f"{report.attempts} attempt" + "s" * (report.attempts > 1)
    said.append(
        f"cold start: {attempts}; cycles until normal active: {', '.join(reached) or 'never'}"
    )
    if reached:
        said += _corrected(report)
    states = [row.state for row in report.nodes]
    ends = [f"{states.count(state)} {state}" for state in dict.fromkeys(states)]
    said.append(f"at the end: {', '.join(ends)}")
    return said


def _corrected(report: ClockReport) -> list[str]:
    """Sentences on a cluster that has started."""
    holds = "within" if report.precision_us <= report.bound_us else "BEYOND"
    lies = f", liars ({report.lying_sync_nodes}) left out" if report.lying_sync_nodes else ""
    return [
        f"precision: {report.precision_us:.3f} us at most in {report.cycles} cycles{lies}, {holds} "
        f"the assumed {report.bound_us:.3f} us (action point offset {report.action_point_us:.2f} "
        "us)",
        f"corrections: rate up to {report.largest_rate_correction} of "
        f"{report.rate_correction_limit} microticks, offset up to "
        f"{report.largest_offset_correction} of {report.offset_correction_limit}",
    ]


def _cycles(found: list[int]) -> str:
    return str(min(found)) if min(found) == max(found) else f"{min(found)} to {max(found)}"
