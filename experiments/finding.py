"""One line of `concord doctor`: what was looked at, how it stands, and what to do."""

from enum import Enum

import msgspec


class Verdict(Enum):
    """How something stands: a warning does not keep a network from running."""

    OK = "ok"
    WARNING = "warning"
    FAILING = "failing"


class Finding(msgspec.Struct, frozen=True):
    """What was looked at, how it stands, what was seen, and what to do (empty if nothing)."""

    subject: str
    verdict: Verdict
    seen: str
    cure: str = ""
