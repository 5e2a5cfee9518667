"""One line of `concord doctor`: what was looked at, how it stands, and what to do."""

from enum import Enum

import msgspec


class Verdict(Enum):
    """How something stands: only a failure keeps a network from running."""

    OK = "ok"
    OPTIONAL = "optional"
    WARNING = "warning"
    FAILING = "failing"


class Finding(msgspec.Struct, frozen=True):
    """Finding: subject, status, observation, and remedy (empty if none is needed)."""

    subject: str
    verdict: Verdict
    seen: str
    cure: str = ""
