"""A network that stops answering, as the page shows it: never paused, never ready for commands."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from concord.dashboard.app import Dashboard
from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.serve import open_network
from concord.runtime.network.network_file import read_network
from tests.processes import CONCORD, PATIENCE_S, family, holds_within

pytestmark = pytest.mark.zenoh
ROOT = Path(__file__).resolve().parents[2]
NETWORK = ["--scenario", "oscillator", "--nodes", "3", "--steps", "1000000"]


def attached(folder: Path) -> Dashboard:
    """Return a page on the network of a folder, once that network answers."""
    found: list[LiveNetwork] = []

    def answers() -> bool:
        try:
            reach = read_network(folder)
            found.append(LiveNetwork(reach.connect, reach.run))
        except (OSError, ValueError):
            return False
        return True

    assert holds_within(PATIENCE_S, answers)
    return open_network(found[0], folder, "127.0.0.1", 0, light=False)


def shows(page: Dashboard, holds: Callable[[str], bool]) -> bool:
    """Return whether the status of the page comes to hold something."""

    def drawn() -> bool:
        page.tick(time.monotonic())
        time.sleep(0.05)
        return holds(page.controls.status.content)

    return holds_within(PATIENCE_S, drawn)


def commands_are_open(page: Dashboard) -> bool:
    """Return whether a person can press what commands the network."""
    controls = page.controls
    assert controls.network is not None
    assert controls.node is not None
    widgets = [controls.pause, controls.one, controls.speed]
    widgets += [*controls.network.widgets, *controls.node.widgets]
    states = {not widget.disabled for widget in widgets}
    states |= {group.visible for group in controls.node.groups}
    assert len(states) == 1, "all of them or none"
    return states.pop()


def test_a_network_that_stops_is_silent_and_one_that_returns_is_shown_again(tmp_path: Path):
    folder = tmp_path / "run"
    command = (*CONCORD, "run", "--driver", "processes", *NETWORK, "--out", str(folder))
    with family(command, ROOT) as run:
        page = attached(folder)
        try:
            assert shows(page, lambda status: ">RUNNING<" in status)
            assert commands_are_open(page)
            # A network that has not begun refuses commands.
            assert holds_within(PATIENCE_S, lambda: page.source.ask({"do": "pause"}).accepted)
            assert shows(page, lambda status: ">PAUSED<" in status)

            stopped = run.alive()
            for process in stopped:
                os.kill(process, signal.SIGSTOP)
            assert shows(page, lambda status: ">SILENT<" in status)
            assert ">PAUSED<" not in page.controls.status.content
            # The page counts on although nothing comes.
            assert shows(page, lambda status: "no answer for 9 s, after" in status)
            assert holds_within(5, lambda: not commands_are_open(page))

            for process in stopped:
                os.kill(process, signal.SIGCONT)
            assert shows(page, lambda status: ">PAUSED<" in status)
            assert holds_within(5, lambda: commands_are_open(page))
            assert page.source.ask({"do": "resume"}).accepted
            last = page.history.last_step
            assert shows(page, lambda _: page.history.last_step > last + 5)

            run.kill_all()
            assert shows(page, lambda status: ">SILENT<" in status)
            assert not page.source.ask({"do": "pause"}).accepted
            assert shows(page, lambda status: ">SILENT<" in status)
            assert holds_within(5, lambda: not commands_are_open(page))
        finally:
            page.close()
