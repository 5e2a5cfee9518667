"""A page that has a network run until a condition holds: the network stands at that step."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from concord.dashboard.app import Dashboard
from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.seeking.breakpoint import QUANTITIES, read_breakpoint
from concord.dashboard.serve import open_network
from concord.runtime.network.network_file import read_network
from tests.dashboard.runs import TARGET_IN_WORDS
from tests.processes import CONCORD, PATIENCE_S, family, holds_within

pytestmark = pytest.mark.zenoh
ROOT = Path(__file__).resolve().parents[2]
NETWORK = [*TARGET_IN_WORDS, "--nodes", "4", "--steps", "20000", "--seed", "3"]


@pytest.fixture(scope="module")
def dashboard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    """A page, which no browser shows, on a network that does at most twenty steps per second."""
    folder = tmp_path_factory.mktemp("until") / "run"
    command = (*CONCORD, "run", "--driver", "processes", *NETWORK, "--out", str(folder))
    with family(command, ROOT):
        assert holds_within(20.0, (folder / "network.json").exists)
        reach = read_network(folder)
        source = LiveNetwork(reach.connect, reach.run)
        slowed = {"do": "speed", "steps_per_second": 20.0}
        assert holds_within(20.0, lambda: source.ask(slowed).accepted)
        page = open_network(source, folder, "127.0.0.1", 0, light=False)
        yield page
        page.close()


def draw_until(dashboard: Dashboard, holds: Callable[[], bool]) -> None:
    def draw() -> None:
        dashboard.tick(time.monotonic())
        time.sleep(0.02)

    assert holds_within(PATIENCE_S, holds, draw), "it never came to hold"


def look_for(dashboard: Dashboard, words: str) -> None:
    until = dashboard.controls.until
    until.condition.value = words
    until._press()
    draw_until(dashboard, lambda: until.words == words)


def test_a_network_runs_until_a_condition_holds_and_stands_there(dashboard: Dashboard):
    history, until = dashboard.history, dashboard.controls.until
    draw_until(dashboard, lambda: len(history) > 20)
    # The largest NIS is another one in each step.
    largest = [QUANTITIES["nis"].value(one, None) for one in history.until(10**9, 20)]
    rare = f"nis > {sorted(largest)[-5]:.3f}"
    # The first time the network runs; from then on the page has it stop at each step.
    for words, is_exact in ((rare, False), (rare, True), ("error > 0", True)):
        before = history.last_step
        look_for(dashboard, words)
        draw_until(dashboard, lambda: not until.words)
        # Steps that had begun before the pause come to their end.
        draw_until(dashboard, lambda: dashboard.source.pace().state == "PAUSED")
        for _ in range(50):
            dashboard.tick(time.monotonic())
            time.sleep(0.02)
        wanted = read_breakpoint(words, dashboard.stage)
        held = [one.step for one in history.after(before) if wanted.holds(one)]
        shown = dashboard.view.step
        assert shown in held
        if is_exact:
            assert (held, history.last_step) == ([shown], shown)
            assert dashboard.source.pace().completed == shown + 1


def test_pause_ends_the_search_and_leaves_the_network_paused(dashboard: Dashboard):
    history, until = dashboard.history, dashboard.controls.until
    look_for(dashboard, "nees > 1e9")
    begun = history.last_step
    draw_until(dashboard, lambda: history.last_step > begun + 2)
    assert until.button.label == "Stop looking"
    dashboard.controls.toggle(None)
    assert until.words == ""
    draw_until(dashboard, lambda: until.button.label == "Run until")
    last = history.last_step
    for _ in range(50):
        dashboard.tick(time.monotonic())
        time.sleep(0.02)
    assert history.last_step <= last + 1
    assert dashboard.source.pace().state == "PAUSED"
