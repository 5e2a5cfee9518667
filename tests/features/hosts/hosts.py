"""A network on several hosts under test: the commands of each, ended with the block."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.processes import CONCORD, Family, family


class Hosts:
    """Starts concord's commands, each as a family of its own; `prefix` says where."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self._stack = folder, stack

    def concord(self, *words: object, prefix: tuple[str, ...] = ()) -> Family:
        """A command that goes on until it, or the block, ends."""
        command = (*prefix, *CONCORD, *map(str, words))
        return self._stack.enter_context(family(command, self.folder))

    def router(self, endpoint: str, *others: str, prefix: tuple[str, ...] = ()) -> Family:
        """A router that listens; what it says first is that it does."""
        connect = ("--connect", *others) if others else ()
        started = self.concord("router", "--listen", endpoint, *connect, prefix=prefix)
        started.await_line("router at")
        return started


@contextmanager
def hosts(folder: Path) -> Iterator[Hosts]:
    """Nothing of them outlives the block."""
    with ExitStack() as stack:
        yield Hosts(folder, stack)
