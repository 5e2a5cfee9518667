"""Test network and page in one command: the network waits for a viewer, then needs none."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from concord.nodes.messages import decode
from concord.runtime.network.control_client import Client
from concord.runtime.network.network_file import read_network
from concord.runtime.recording import read_recording
from tests.dashboard.browser_page import press_on, row_of, slot_of
from tests.dashboard.browser_tab import new_tab
from tests.dashboard.runs import TARGET_IN_WORDS
from tests.processes import PATIENCE_S, PROC, Family, family, holds_within, lives

pytestmark = pytest.mark.zenoh
ROOT = Path(__file__).resolve().parents[2]
NETWORK = [*TARGET_IN_WORDS, "--nodes", "4", "--seed", "3"]


@pytest.fixture
def launched(chromium, tmp_path: Path) -> Iterator[tuple[Family, Path]]:
    folder = tmp_path / "run"
    started = family(
        (
            sys.executable,
            "launch_local.py",
            *NETWORK,
            "--steps",
            "3000",
            "--out",
            str(folder),
            "--dashboard",
            "--http-port",
            "0",
        ),
        ROOT,
    )
    with started as command:
        yield command, folder


def page_process(command: Family) -> int:
    """The process of the page that a launcher has started."""
    pages = [
        pid for pid in command.descendants()
        if b"\0dashboard\0" in (PROC / str(pid) / "cmdline").read_bytes()
    ]  # fmt: skip
    assert len(pages) == 1
    return pages[0]


def test_a_network_waits_for_who_looks_and_goes_on_without(chromium, launched: tuple[Family, Path]):
    command, folder = launched
    url = command.await_line("dashboard at ").split()[2]
    reach = read_network(folder)
    client = Client(reach.connect, reach.run)

    def state() -> dict[str, Any]:
        return client.state()

    assert state()["paused"]
    page = new_tab(chromium)
    page.goto(f"{url}&fixedDpr=0.5")
    assert holds(page, lambda: not state()["paused"])
    assert state()["steps_per_second"] == 5
    assert holds(page, lambda: page.get_by_test_id("run-state").first.text_content() == "RUNNING")

    # Every panel is drawn several times a second, and its slots move: a press that comes too late
    # hits another slot, and a hand presses again.
    for node in (2, 0):
        row = page.locator(row_of(node))

        def is_chosen(row=row) -> bool:
            return "background" in (row.get_attribute("style") or "")

        def chosen_by_press(node=node, is_chosen=is_chosen) -> bool:
            press_on(page, slot_of(node))
            return holds_within(2, is_chosen, lambda: page.wait_for_timeout(50))

        assert holds(page, chosen_by_press)
    page.get_by_role("button", name="Pause", exact=True).click()
    assert holds(page, lambda: state()["paused"])
    page.get_by_role("button", name="Resume", exact=True).click()
    assert holds(page, lambda: not state()["paused"])

    # Without a word, as if its terminal were gone.
    number = page_process(command)
    os.kill(number, signal.SIGKILL)
    assert holds_within(5, lambda: not lives(number))
    page.close()
    completed = state()["completed"]
    assert holds_within(20, lambda: state()["completed"] > completed + 5)
    assert state()["members"] == [0, 1, 2, 3]
    client.close()
    command.send(signal.SIGTERM)
    assert command.gone_within(10)


def test_a_network_whose_page_is_killed_before_its_first_step_goes_on(tmp_path: Path):
    folder = tmp_path / "run"
    asked = (*NETWORK, "--steps", "3000", "--out", str(folder), "--dashboard", "--http-port", "0")
    with family((sys.executable, "launch_local.py", *asked), ROOT) as command:
        command.await_line("dashboard at ")
        reach = read_network(folder)
        client = Client(reach.connect, reach.run)
        assert client.state()["paused"]
        os.kill(page_process(command), signal.SIGKILL)
        command.await_line("the page ended before the first step; the network goes on without it")
        assert holds_within(PATIENCE_S, lambda: client.state()["completed"] > 5)
        client.close()
        command.send(signal.SIGTERM)
        assert command.gone_within(10)


def test_the_page_stays_when_the_run_is_over(chromium, tmp_path: Path):
    folder = tmp_path / "run"
    asked = (*NETWORK, "--steps", "24", "--out", str(folder), "--dashboard", "--http-port", "0")
    with family((sys.executable, "launch_local.py", *asked), ROOT) as command:
        url = command.await_line("dashboard at ").split()[2]
        page = new_tab(chromium)
        page.goto(f"{url}&fixedDpr=0.5")
        command.await_line("the run is over; its page stays until Ctrl-C")
        assert (folder / "run.nc").is_file()
        state = page.get_by_test_id("run-state").first
        assert holds(page, lambda: state.text_content() == "ENDED")
        words = f"24 of 24 steps; results in {folder}"
        assert holds(page, lambda: words in page.locator("body").inner_text())
        step = page.get_by_test_id("step").first
        assert holds(page, lambda: step.text_content() == "23")
        # The page plays what it has received.
        page.get_by_role("button", name="Resume", exact=True).click()
        assert holds(page, lambda: int(step.text_content()) < 23)
        assert holds(page, lambda: step.text_content() == "23")
        # Its steps can be looked at, and its nodes selected.
        press_on(page, row_of(2))
        row = page.locator(row_of(2))
        assert holds(page, lambda: "background" in (row.get_attribute("style") or ""))
        page.wait_for_timeout(2000)
        assert lives(command.process.pid)
        assert state.text_content() == "ENDED"
        # The same run again, in the next folder, on the page that is open.
        page.get_by_role("button", name="Run again", exact=True).click()
        command.await_line("dashboard at ", 3 * PATIENCE_S)
        command.await_line("the run is over; its page stays until Ctrl-C", 3 * PATIENCE_S)
        again = folder.with_name("run-2")
        assert holds(page, lambda: f"results in {again}" in page.locator("body").inner_text())
        assert (again / "run.nc").is_file()
        assert estimates_in(again) == estimates_in(folder)
        assert page.get_by_role("button", name="Run again", exact=True).is_enabled()
        page.close()
        command.send_to_a_thread(signal.SIGINT)
        assert command.gone_within(10)
        assert command.process.wait() == 0


def estimates_in(folder: Path) -> list[tuple[Any, ...]]:
    """The mean and covariance of each node after each step, as they were recorded."""
    told = (
        (topic, decode(topic, data))
        for topic, data in read_recording(folder / "run.mcap")
        if topic.startswith("estimate/")
    )
    return sorted((topic, one.step, one.mean, one.cov) for topic, one in told)


def holds(page, condition: Callable[[], bool]) -> bool:
    """Whether something comes to hold while the browser works."""
    return holds_within(PATIENCE_S, condition, lambda: page.wait_for_timeout(50))
