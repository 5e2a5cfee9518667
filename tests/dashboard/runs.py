"""Small recorded runs for the tests of the dashboard."""

import msgspec

from dashboard.frame import Frame
from dashboard.replay import assembled
from dashboard.stage import Stage, set_stage
from experiments.drivers import in_memory
from scenarios.catalogue import kind_of
from scenarios.setup import Setup, prepare

Messages = list[tuple[str, bytes]]


def setup_of(name: str, **changes) -> Setup:
    """A scenario with its own defaults but for these changes, worked out."""
    return prepare(msgspec.structs.replace(kind_of(name).defaults, **changes))


def run_of(name: str, **changes) -> tuple[Stage, Messages]:
    """Stage and messages of a run in this process."""
    setup = setup_of(name, **changes)
    return set_stage(setup), in_memory(setup)


def frames_of(stage: Stage, messages: Messages) -> list[Frame]:
    """The frames that these messages make."""
    return list(assembled(stage, messages))


def event(step: int, **change: object) -> tuple[str, bytes]:
    """A message that tells of a change."""
    return "event", msgspec.json.encode({"step": step, "change": change})
