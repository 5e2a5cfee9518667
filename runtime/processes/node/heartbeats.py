"""The heartbeats of a node in real time, which may be late or missing."""

from msgspec.structs import replace

from concord.nodes.changes import Change
from concord.nodes.messages import Measured


class Heartbeats:
    """Remembers what readings look like, and changes that no heartbeat has brought in time."""

    def __init__(self) -> None:
        self._pattern: tuple[Measured, ...] = ()
        self._overdue: tuple[Change, ...] = ()
        self._blank_step = -1

    @property
    def are_known(self) -> bool:
        """Whether a heartbeat has shown what readings look like here."""
        return bool(self._pattern)

    def was_blank(self, step: int) -> bool:
        """Whether the node has begun this step without a heartbeat."""
        return step == self._blank_step

    def opening(self, measured: Measured) -> Measured:
        """A heartbeat that is in time, with the changes that are overdue."""
        self._pattern = (measured,)
        changes, self._overdue = (*self._overdue, *measured.changes), ()
        return replace(measured, changes=changes)

    def miss(self, measured: Measured) -> None:
        """A heartbeat came too late for its step; its changes hold from now on."""
        self._overdue += measured.changes

    def blank(self, step: int) -> Measured:
        """The heartbeat of a step without readings, with the control that was known last."""
        self._blank_step = step
        (last,) = self._pattern
        readings = [[None] * len(reading) for reading in last.readings]
        changes, self._overdue = self._overdue, ()
        return replace(last, step=step, readings=readings, changes=changes)
