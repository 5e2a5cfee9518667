"""Hosts under test: Linux network namespaces with addresses of their own, joined by a bridge."""

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest


def _ip(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    return subprocess.run(("ip", *words), check=check, capture_output=True, text=True)


class Lan:
    """Namespaces a, b, c, ... at 10.77.0.1, 2, 3, ..., each with a cable to a bridge."""

    def __init__(self, hosts: Sequence[str]) -> None:
        self._hosts = tuple(hosts)
        self._mark = f"cc{os.getpid()}"
        self._centre = f"{self._mark}-centre"

    def build(self) -> None:
        _ip("netns", "add", self._centre)
        self._at_centre("link", "add", "bridge", "type", "bridge")
        self._at_centre("link", "set", "bridge", "up")
        for number, host in enumerate(self._hosts, start=1):
            namespace = f"{self._mark}-{host}"
            _ip("netns", "add", namespace)
            far = ("peer", "name", "cable", "netns", namespace)
            self._at_centre("link", "add", f"to-{host}", "type", "veth", *far)
            self._at_centre("link", "set", f"to-{host}", "master", "bridge", "up")
            for words in (
                ("link", "set", "lo", "up"),
                ("addr", "add", f"10.77.0.{number}/24", "dev", "cable"),
                ("link", "set", "cable", "up"),
            ):
                _ip("-n", namespace, *words)

    def _at_centre(self, *words: str) -> None:
        _ip("-n", self._centre, *words)

    def destroy(self) -> None:
        """Whatever there is of it."""
        for host in (*self._hosts, "centre"):
            _ip("netns", "del", f"{self._mark}-{host}", check=False)

    def endpoint(self, host: str) -> str:
        """Where the router of a host listens."""
        return f"tcp/10.77.0.{1 + self._hosts.index(host)}:7447"

    def at(self, host: str) -> tuple[str, ...]:
        """Return the prefix of a command that runs on a host."""
        return ("ip", "netns", "exec", f"{self._mark}-{host}")

    def pull(self, host: str) -> None:
        """Disconnect a host from the bridge."""
        self._at_centre("link", "set", f"to-{host}", "down")

    def plug(self, host: str) -> None:
        """And put it back."""
        self._at_centre("link", "set", f"to-{host}", "up")

    def delay(self, host: str, milliseconds: int) -> bool:
        """Delay each packet of a host; return False where the kernel has no netem."""
        words = ("qdisc", "add", "dev", "cable", "root", "netem", "delay", f"{milliseconds}ms")
        return subprocess.run((*self.at(host), "tc", *words), capture_output=True).returncode == 0


@contextmanager
def lan(hosts: Sequence[str]) -> Iterator[Lan]:
    """Hosts on one network; the test is skipped, with the reason, where there can be none."""
    built = Lan(hosts)
    try:
        built.build()
    except (OSError, subprocess.CalledProcessError) as error:
        built.destroy()
        why = error.stderr.strip() if isinstance(error, subprocess.CalledProcessError) else error
        pytest.skip(f"no network namespaces here: {why}")
    try:
        yield built
    finally:
        built.destroy()
