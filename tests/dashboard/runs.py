"""Small recorded runs for the tests of the dashboard."""

from functools import cache

import msgspec

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.replay import assembled
from concord.dashboard.frames.stage import Stage, set_stage
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup

Messages = list[tuple[str, bytes]]


def setup_of(name: str, **changes) -> Setup:
    """A scenario with its own defaults but for these changes, worked out."""
    return prepare(definition_named(name).defaults.with_(**changes))


@cache
def run_of(name: str, **changes) -> tuple[Stage, Messages]:
    """Stage and messages of a run in this process, which is made once."""
    setup = setup_of(name, **changes)
    return set_stage(setup), in_memory(setup)


def frames_of(stage: Stage, messages: Messages) -> list[StepFrame]:
    """The frames that these messages make."""
    return list(assembled(stage, messages))


def event(step: int, **change: object) -> tuple[str, bytes]:
    """A message that tells of a change."""
    return "event", msgspec.json.encode({"step": step, "change": change})
