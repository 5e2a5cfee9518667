"""Small runs for the tests of experiments/."""

from pathlib import Path

from concord.experiments.results.trace import Trace, read_trace
from concord.runtime.recording import read_recording
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup


def scenario(name: str = "oscillator", **changes) -> Scenario:
    """A scenario with its own defaults but for these changes."""
    return definition_named(name).defaults.with_(**changes)


def small(name: str = "oscillator", **changes) -> Setup:
    """Four nodes, a few steps."""
    return prepare(scenario(name, **{"nodes": 4, "steps": 12, **changes}))


def trace_of(setup: Setup, recording: Path) -> Trace:
    """The arrays of a recording."""
    return read_trace(setup, read_recording(recording))
