"""Small runs for the tests of experiments/."""

from pathlib import Path

import msgspec

from experiments.trace import Trace, read_trace
from nodes.recording import read_recording
from scenarios.catalogue import kind_of
from scenarios.scenario import Scenario
from scenarios.setup import Setup, prepare


def scenario(name: str = "oscillator", **changes) -> Scenario:
    """A scenario with its own defaults but for these changes."""
    return msgspec.structs.replace(kind_of(name).defaults, **changes)


def small(name: str = "oscillator", **changes) -> Setup:
    """Four nodes, a few steps."""
    return prepare(scenario(name, **{"nodes": 4, "steps": 12, **changes}))


def trace_of(setup: Setup, recording: Path) -> Trace:
    """The arrays of a recording."""
    return read_trace(setup, read_recording(recording))
