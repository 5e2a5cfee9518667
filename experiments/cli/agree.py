"""`concord agree`: run one scenario in every driver and compare.

Drivers that pass messages must agree bit for bit, the batched one to 1e-10 of the scale.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import tyro

from experiments.cli.scenario_flags import ScenarioFlags, resolved
from experiments.progress import progress
from experiments.results.near_agreement import TOLERANCE, departures
from experiments.results.trace import Trace, read_trace
from experiments.user_errors import user_errors
from runtime.batched.build import without_array_form
from runtime.drivers import DRIVERS
from runtime.processes.launcher import NetworkFailed
from runtime.recording import read_recording
from scenarios.preparation import prepare
from scenarios.setup import Setup

BATCHED = "batched"
_COMPARED = ("truth", "readings", "published", "mean", "cov", "ages")


class DriverDifference(msgspec.Struct, frozen=True):
    """Where two drivers first part: the quantity, its index, and both values."""

    driver: str
    quantity: str
    index: list[int]
    reference: float
    value: float


@dataclass(frozen=True)
class AgreeOptions:
    """How to show it."""

    json: bool = False
    """Print one JSON object."""


def agree(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    output: Annotated[AgreeOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Run a scenario in every driver; exit code 1 if they do not agree."""
    with user_errors():
        setup = prepare(resolved(scenario))
    traces = {driver: _run(setup, driver) for driver in DRIVERS}
    reference = next(iter(traces))
    differences = [
        difference
        for driver, trace in traces.items()
        if (difference := first_difference(traces[reference], trace, driver)) is not None
    ]
    near = without_array_form(setup.scenario) is None
    if near:
        differences += near_differences(setup, traces[reference])
    _show(setup, list(traces), near, differences, output.json)
    sys.exit(1 if differences else 0)


def _run(setup: Setup, driver: str) -> Trace:
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        name = f"agree-{Path(folder).name}"
        try:
            with progress(driver, setup.scenario.steps) as on_step:
                DRIVERS[driver](setup, name, recording, None, on_step)
        except NetworkFailed as error:
            sys.stderr.write(f"concord: {error}\n")
            sys.exit(1)
        return read_trace(setup, read_recording(recording))


def first_difference(reference: Trace, trace: Trace, driver: str) -> DriverDifference | None:
    """Return the first entry, step by step, whose bits are not those of the reference."""
    earliest: DriverDifference | None = None
    for quantity in _COMPARED:
        ours, theirs = getattr(reference, quantity), getattr(trace, quantity)
        if ours.shape != theirs.shape:
            return DriverDifference(driver, f"{quantity} shape", [], ours.size, theirs.size)
        # Equal bits, not equal values: NaN equals itself, and 0.0 is not -0.0.
        unequal = np.argwhere(ours.view(f"u{ours.itemsize}") != theirs.view(f"u{theirs.itemsize}"))
        if len(unequal) and (earliest is None or unequal[0][0] < earliest.index[0]):
            index = tuple(unequal[0].tolist())
            earliest = DriverDifference(
                driver, quantity, list(index), float(ours[index]), float(theirs[index])
            )
    return earliest


def near_differences(setup: Setup, reference: Trace) -> list[DriverDifference]:
    """Where the batched driver departs from a trace by more than rounding, by quantity."""
    return [
        DriverDifference(BATCHED, name, where.tolist(), float(expected), float(value))
        for name, (where, expected, value) in departures(setup, reference).items()
    ]


def _show(
    setup: Setup, drivers: list[str], near: bool, differences: list[DriverDifference], as_json: bool
) -> None:
    scenario = setup.scenario
    if as_json:
        result = {
            "scenario": scenario,
            "drivers": drivers + [BATCHED] * near,
            "differences": differences,
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    what = (
        f"{scenario.name}, {scenario.nodes} nodes, {scenario.network.graph}, {scenario.steps} steps"
    )
    if not differences:
        also = f"; {BATCHED} to {TOLERANCE:g}" if near else ""
        sys.stdout.write(f"{what}: {' = '.join(drivers)}, bit for bit{also}\n")
    for d in differences:
        sys.stdout.write(
            f"{what}: {d.driver} differs from {drivers[0]} first in {d.quantity} at index "
            f"{tuple(d.index)} (step first): {d.value!r} instead of {d.reference!r}\n"
        )
