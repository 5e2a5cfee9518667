"""Small recorded runs for the tests of the dashboard."""

from functools import cache, cached_property

import msgspec

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.source import assembled
from concord.dashboard.frames.stage import Stage, set_stage
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup

Messages = list[tuple[str, bytes]]


EVERY_SHARE = {"rule": "ci", "number": "float64", "schedule": "full"}
"""Options with which every node sends a whole belief in every cycle."""
TARGET_IN_WORDS = ["--scenario", "target-tracking"] + [
    word for name, value in EVERY_SHARE.items() for word in (f"--{name}", value)
]


def setup_of(name: str, **changes) -> Setup:
    """A scenario with its own defaults but for these changes, worked out.

    A target is followed by rule ci on the full bus, so that each step shows every share.
    """
    usual = definition_named(name).defaults
    if name.startswith("target-") and usual.rule.name == "sharp-ci":
        usual = usual.with_(**EVERY_SHARE)
    return prepare(usual.with_(**changes))


class RunInMemory:
    """A run in this process, made when a test first asks for it."""

    def __init__(self, name: str, changes: dict) -> None:
        self._name, self._changes = name, changes

    @cached_property
    def stage(self) -> Stage:
        """The stage that all its frames share."""
        return set_stage(self._setup)

    @cached_property
    def messages(self) -> Messages:
        """The messages of its nodes and its environment, in order."""
        return in_memory(self._setup)

    @cached_property
    def frames(self) -> list[StepFrame]:
        """The frames that its messages make."""
        return frames_of(self.stage, self.messages)

    @cached_property
    def _setup(self) -> Setup:
        return setup_of(self._name, **self._changes)


@cache
def run_of(name: str, **changes) -> RunInMemory:
    """A scenario's run with these settings, which is made once."""
    return RunInMemory(name, changes)


def frames_of(stage: Stage, messages: Messages) -> list[StepFrame]:
    """The frames that these messages make."""
    return list(assembled(stage, messages))


def event(step: int, **change: object) -> tuple[str, bytes]:
    """A message that tells of a change."""
    return "event", msgspec.json.encode({"step": step, "change": change})
