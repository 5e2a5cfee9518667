"""Agreement of the drivers on one setup: equal bits, and 1e-10 of the scale for the batched one."""

import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from concord.results.folder import BATCHED
from concord.results.records.trace import Trace, read_trace
from concord.runtime.batched.build import without_array_form
from concord.runtime.drivers import DRIVERS
from concord.runtime.recording import read_recording
from concord.scenarios.setup import Setup
from concord.studies.near_agreement import departures

_COMPARED = (
    "truth", "readings", "published", "payload_bytes", "classes", "mean", "cov", "ages",
)  # fmt: skip
OnStep = Callable[[int], None]


class DriverDifference(msgspec.Struct, frozen=True):
    """Where two drivers first part: the quantity, its index, and both values."""

    driver: str
    quantity: str
    index: list[int]
    reference: float
    value: float


class Agreement(NamedTuple):
    """The drivers that gave messages, whether the batched one was compared too, and differences."""

    drivers: list[str]
    near: bool
    differences: tuple[DriverDifference, ...]


def _silent(_driver: str, _steps: int) -> AbstractContextManager[OnStep]:
    return nullcontext(lambda _: None)


def agreement(
    setup: Setup, progress: Callable[[str, int], AbstractContextManager[OnStep]] = _silent
) -> Agreement:
    """Run a setup in every driver that can, and compare each with the first.

    Raises:
        NetworkFailed: a process died.
    """
    traces = {driver: _trace(setup, driver, progress) for driver in DRIVERS}
    reference = next(iter(traces))
    found = [first_difference(traces[reference], trace, driver) for driver, trace in traces.items()]
    differences = [difference for difference in found if difference is not None]
    near = without_array_form(setup.scenario) is None
    if near:
        differences += near_differences(setup, traces[reference])
    return Agreement(list(traces), near, tuple(differences))


def _trace(
    setup: Setup, driver: str, progress: Callable[[str, int], AbstractContextManager[OnStep]]
) -> Trace:
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        name = f"agree-{Path(folder).name}"
        with progress(driver, setup.scenario.steps) as on_step:
            DRIVERS[driver](setup, name, recording, None, on_step)
        return read_trace(setup, read_recording(recording))


def first_difference(reference: Trace, trace: Trace, driver: str) -> DriverDifference | None:
    """Return the first entry, step by step, whose bits are not those of the reference."""
    earliest: DriverDifference | None = None
    for quantity, ours in _quantities(reference).items():
        theirs = _quantities(trace)[quantity]
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


def _quantities(trace: Trace) -> dict[str, np.ndarray]:
    suspect = {} if trace.suspect is None else {"suspect": trace.suspect}
    past = (
        {} if trace.past is None else {"smoothed": trace.past.mean, "smoothed std": trace.past.std}
    )
    extra = {} if trace.extra is None else {"tracks": trace.extra.digest_numbers()}
    return {name: getattr(trace, name) for name in _COMPARED} | suspect | past | extra


def near_differences(setup: Setup, reference: Trace) -> list[DriverDifference]:
    """Where the batched driver departs from a trace by more than rounding, by quantity."""
    return [
        DriverDifference(BATCHED, name, where.tolist(), float(expected), float(value))
        for name, (where, expected, value) in departures(setup, reference).items()
    ]
