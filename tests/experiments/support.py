"""Small runs for the tests of experiments/."""

from pathlib import Path

from experiments.results.trace import Trace, read_trace
from runtime.recording import read_recording
from scenarios.catalogue import definition_of
from scenarios.preparation import prepare
from scenarios.scenario import Scenario
from scenarios.setup import Setup


def scenario(name: str = "oscillator", **changes) -> Scenario:
    """A scenario with its own defaults but for these changes."""
    return definition_of(name).defaults.with_(**changes)


def small(name: str = "oscillator", **changes) -> Setup:
    """Four nodes, a few steps."""
    return prepare(scenario(name, **{"nodes": 4, "steps": 12, **changes}))


def trace_of(setup: Setup, recording: Path) -> Trace:
    """The arrays of a recording."""
    return read_trace(setup, read_recording(recording))
