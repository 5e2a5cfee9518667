"""Eight node processes behind a page in a real browser: what is pressed becomes of the network."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.frames.source import replayed
from concord.dashboard.panels.network_controls import NetworkControls
from concord.dashboard.panels.node_controls import NodeControls
from concord.dashboard.serve import open_network
from concord.dashboard.theme import linear
from concord.runtime.network.control_client import Client
from concord.runtime.network.network_file import read_network
from concord.scenarios.types.schedules import occupancy_of
from tests.dashboard.browser_page import Page, press_on, row_of, slot_of
from tests.dashboard.runs import TARGET_IN_WORDS
from tests.processes import CONCORD, family, holds_within, lives

pytestmark = pytest.mark.zenoh
ROOT = Path(__file__).resolve().parents[2]
NETWORK = [*TARGET_IN_WORDS, "--nodes", "8", "--steps", "20000", "--seed", "3"]
STEPS_PER_S = 8.0


@pytest.fixture(scope="module")
def network(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a network that runs, and is slowed down to what an eye can follow."""
    folder = tmp_path_factory.mktemp("live") / "run"
    command = (*CONCORD, "run", "--driver", "processes", *NETWORK, "--out", str(folder))
    with family(command, ROOT):
        assert holds_within(20.0, (folder / "network.json").exists)
        yield folder


@pytest.fixture(scope="module")
def onlooker(network: Path) -> Iterator[Client]:
    """Yield a client beside the page that asks the network itself."""
    reach = read_network(network)
    client = Client(reach.connect, reach.run)
    yield client
    client.close()


@pytest.fixture(scope="module")
def page(chromium, network: Path) -> Iterator[Page]:
    reach = read_network(network)
    source = LiveNetwork(reach.connect, reach.run)
    # A machine at its limit may say: try again.
    slowed = {"do": "speed", "steps_per_second": STEPS_PER_S}
    assert holds_within(20.0, lambda: source.ask(slowed).accepted)
    dashboard = open_network(source, network, "127.0.0.1", 0, light=True)
    shown = Page(dashboard, chromium)
    yield shown
    shown.close()


@pytest.fixture(autouse=True)
def _running(page: Page) -> None:
    page.until(lambda: page.text("run-state") in ("RUNNING", "PAUSED"))
    if page.text("run-state") == "PAUSED":
        page.press("Resume")
        page.until(lambda: page.text("run-state") == "RUNNING")
    page.dashboard.controls.follow()


def events(page: Page) -> str:
    return " / ".join(event.text for event in page.dashboard.history.log)


def newest(page: Page) -> StepFrame:
    return page.dashboard.history.at(10**9)


def select(page: Page, node: int) -> None:
    """Choose a node from the dropdown, and see the page take it."""
    page.choose("Node", page.dashboard.stage.names[node])
    page.until(lambda: page.dashboard.view.selected == node)


def steps_on(page: Page, steps: int) -> None:
    """Let the network do so many steps more."""
    last = page.dashboard.history.last_step
    page.until(lambda: page.dashboard.history.last_step >= last + steps)


def paints(page: Page, node: int, colour: tuple[int, int, int]) -> bool:
    """Whether the scene has a node in that colour."""
    shown = page.part("/network/nodes")["batched_colors"][3 * node : 3 * node + 3]
    return shown == linear(np.array(colour)).tolist()


def test_the_network_is_drawn_as_it_runs(page: Page):
    step = int(page.text("step"))
    page.until(lambda: int(page.text("step")) > step + 10)
    page.until(lambda: page.text("alive") == "8 / 8")
    assert "/network/nodes" in page.scene()
    page.until(lambda: len(page.chart_points()) >= 4 and min(page.chart_points()[:4]) > 5)


def test_a_page_that_comes_to_a_paused_network_shows_where_it_stands(
    chromium, page: Page, onlooker: Client, network: Path
):
    page.press("Pause")
    page.until(lambda: page.text("run-state") == "PAUSED")
    page.until(lambda: stands_still_at(page, onlooker, onlooker.state()["completed"] - 1))
    reach = read_network(network)
    source = LiveNetwork(reach.connect, reach.run)
    later = Page(open_network(source, network, "127.0.0.1", 0, light=False), chromium)
    try:
        for name in ("step", "rmse", "alive", "bus-cycle"):
            later.until(lambda name=name: later.text(name) == page.text(name))
        # The filter that hears everything has taken the readings of all steps before.
        assert float(later.text("central").split()[0]) > 0
        told = replayed(later.dashboard.stage, network / "run.mcap")
        step = int(later.text("step"))
        heard = next(one for one in told if one.step == step)
        assert newest(later).scores.central == heard.scores.central
        later.press("Step")
        later.until(lambda: later.text("step") == str(step + 1))
        assert later.text("run-state") == "PAUSED"
    finally:
        later.close()


def stands_still_at(page: Page, onlooker: Client, step: int) -> bool:
    """Whether the network, and the page with it, has done this step and does no other."""
    for _ in range(8):
        page.page.wait_for_timeout(50)
        page.draw()
        # Steps count from zero.
        if onlooker.state()["completed"] != step + 1 or page.dashboard.history.last_step != step:
            return False
    return True


def pause(page: Page, onlooker: Client, act: Callable[[], None]) -> int:
    """Pause the network by what `act` does on the page; the step at which it stands."""
    act()
    page.until(lambda: page.text("run-state") == "PAUSED")

    def all_done() -> bool:
        state = onlooker.state()
        done = state["completed"] == state["released"]
        return done and page.dashboard.history.last_step == state["completed"] - 1

    page.until(all_done)
    return page.dashboard.history.last_step


def test_pause_stops_every_process_and_step_takes_one(page: Page, onlooker: Client):
    last = pause(page, onlooker, lambda: page.press("Pause"))
    assert stands_still_at(page, onlooker, last)
    page.press("Step")
    page.until(lambda: page.text("step") == str(last + 1))
    assert stands_still_at(page, onlooker, last + 1)


def test_what_the_network_said_before_a_command_is_not_believed_after_it(
    page: Page, onlooker: Client, monkeypatch: pytest.MonkeyPatch
):
    asked, told = Event(), Event()
    source = page.dashboard.source
    assert isinstance(source, LiveNetwork)
    client = source._client
    ask = client.state

    def late() -> dict:
        answer = ask()
        asked.set()
        told.wait(30)
        return answer

    monkeypatch.setattr(client, "state", late)
    page.until(asked.is_set)
    page.press("Pause")
    page.until(lambda: page.text("run-state") == "PAUSED")
    told.set()
    for _ in range(5):
        page.page.wait_for_timeout(40)
        page.draw()
        assert page.text("run-state") == "PAUSED"


def test_keys_do_as_the_buttons_do(page: Page, onlooker: Client):
    last = pause(page, onlooker, lambda: page.key("p"))
    page.key("n")
    page.until(lambda: page.text("step") == str(last + 1))
    assert stands_still_at(page, onlooker, last + 1)
    page.key("p")
    page.until(lambda: page.text("run-state") == "RUNNING")
    steps_on(page, 3)


def test_a_press_on_a_bus_that_is_drawn_again_and_again_selects(page: Page):
    for node in (6, 1, 4):
        press_on(page.page, slot_of(node))
        page.until(lambda node=node: page.dashboard.view.selected == node)
        page.until(lambda node=node: page.chosen("Node") == page.dashboard.stage.names[node])


def test_a_killed_node_is_gone_and_a_restarted_one_rejoins(
    page: Page, network: Path, onlooker: Client
):
    pid = read_network(network).pids["3"]
    assert lives(pid)
    press_on(page.page, row_of(3))
    page.until(lambda: page.chosen("Node") == "03")
    page.press("kill")
    assert holds_within(3.0, lambda: not lives(pid))
    assert holds_within(3.0, lambda: onlooker.state()["members"] == [0, 1, 2, 4, 5, 6, 7])
    page.until(lambda: page.row(3).get_attribute("data-state") == "down")
    page.until(lambda: page.text("alive") == "7 / 8")
    page.until(lambda: paints(page, 3, page.dashboard.view.theme.down))
    page.until(lambda: not newest(page).alive[3])
    page.until(lambda: "node 03 was killed" in events(page))
    page.press("restart")
    page.until(lambda: page.row(3).get_attribute("data-state") != "down")
    page.until(lambda: page.text("alive") == "8 / 8")
    page.until(lambda: not paints(page, 3, page.dashboard.view.theme.down))
    page.until(lambda: "node 03 is back" in events(page))
    page.until(lambda: bool(newest(page).alive.all()))
    assert holds_within(3.0, lambda: lives(read_network(network).pids["3"]))
    assert holds_within(3.0, lambda: onlooker.state()["members"] == list(range(8)))


def test_a_cut_link_carries_nothing_until_it_is_healed(page: Page):
    neighbour = page.dashboard.stage.setup.neighbours[0][0]
    select(page, 0)
    page.choose("Link to", f"{neighbour:02d}")
    page.press("cut")
    page.until(lambda: page.text("cut").startswith("1 /"))
    page.until(lambda: page.row(0).get_attribute("data-state") in ("stale", "down"))
    page.until(lambda: page.part("/network/cut")["shown"])
    pairs = {tuple(map(int, pair)) for pair in page.dashboard.stage.heard[newest(page).lost]}
    assert pairs == {(0, neighbour), (neighbour, 0)}
    page.press("heal")
    page.until(lambda: page.text("cut").startswith("0 /"))
    page.until(lambda: not newest(page).lost.any())
    page.until(lambda: not page.part("/network/cut")["shown"])


def test_a_link_loses_the_part_of_its_frames_that_was_asked_for(page: Page, onlooker: Client):
    neighbour = page.dashboard.stage.setup.neighbours[7][0]
    select(page, 7)
    page.choose("Link to", f"{neighbour:02d}")
    page.page.wait_for_timeout(100)
    page.enter("Loss", 0.5)
    page.until(lambda: f"link 07 → {neighbour:02d} loses 50 %" in events(page))
    losses = {
        (sender, receiver): p for sender, receiver, p in onlooker.state()["standing"]["losses"]
    }
    assert losses == {(7, neighbour): 0.5, (neighbour, 7): 0.5}
    since = page.dashboard.history.last_step + 1
    steps_on(page, 25)
    frames = page.dashboard.history.until(10**9, page.dashboard.history.last_step - since + 1)
    heard = page.dashboard.stage.heard
    lost = np.array([frame.lost for frame in frames])
    ours = np.isin(heard[:, 0], (7, neighbour)) & np.isin(heard[:, 1], (7, neighbour))
    # Of 50 tosses of a coin fewer than 5 or more than 45 come once in a billion times.
    assert 5 <= lost[:, ours].sum() <= lost[:, ours].size - 5
    assert not lost[:, ~ours].any()
    page.enter("Loss", 0)
    page.until(lambda: all(not p for *_, p in onlooker.state()["standing"]["losses"]))
    steps_on(page, 2)
    page.until(lambda: not newest(page).lost.any())


def node_controls(page: Page) -> NodeControls:
    found = page.dashboard.controls.node
    assert found is not None
    return found


def network_controls(page: Page) -> NetworkControls:
    found = page.dashboard.controls.network
    assert found is not None
    return found


def test_faults_are_asked_for_in_words(page: Page, onlooker: Client):
    def say(words: str) -> None:
        page.widget("Fault").locator("input").first.fill(words)
        page.until(lambda: node_controls(page).fault.value == words)
        page.press("Inject")

    say("crc 5 1")
    page.until(lambda: len(onlooker.state()["standing"]["faults"]) == 1)
    page.page.get_by_text("Log", exact=True).first.click()
    page.until(lambda: "crc 05 1" in page.text("log"))
    say("korrupt 1")
    page.until(lambda: page.page.get_by_text("did you mean 'corrupt'?").count() > 0)
    say("calm")
    page.until(lambda: not onlooker.state()["standing"]["faults"])


def test_speed_is_that_of_the_slider(page: Page, onlooker: Client):
    page.enter("Steps/s", 4)
    page.until(lambda: onlooker.state()["steps_per_second"] == 4)
    began_s, first = time.monotonic(), onlooker.state()["released"]
    page.until(lambda: time.monotonic() > began_s + 2.0)
    done = onlooker.state()["released"] - first
    # Not all beats that a busy machine has been late with fall into the two seconds.
    assert 0 < done <= 4 * (time.monotonic() - began_s) + 4
    page.enter("Steps/s", STEPS_PER_S)
    page.until(lambda: onlooker.state()["steps_per_second"] == STEPS_PER_S)


def test_rule_and_rounds_hold_from_the_next_step_for_all(page: Page, onlooker: Client):
    page.choose("Rule", "wac")
    page.until(lambda: network_controls(page).rule.value == "wac")
    page.enter("Rounds", 2)
    page.until(lambda: network_controls(page).rounds.value == 2)
    page.press("Apply at the next step")
    page.until(lambda: page.dashboard.stage.setup.scenario.rule.name == "wac")
    page.until(lambda: len(newest(page).cycles) == 2)
    assert onlooker.state()["standing"]["settings"] == {"rule": "wac", "rounds": 2}
    page.page.get_by_text("Log", exact=True).first.click()
    page.until(lambda: "rule wac" in page.text("log"))


def test_occupancy_and_arbiter_give_the_bus_to_fewer_and_to_others(page: Page, onlooker: Client):
    assert all(len(in_static(cycle)) == 8 for cycle in newest(page).cycles)
    page.enter("Occupancy", 0.5)
    page.until(lambda: network_controls(page).occupancy.value == 0.5)
    page.choose("Arbiter", "round-robin")
    page.until(lambda: network_controls(page).arbiter.value == "round-robin")
    page.press("Apply at the next step")
    page.until(lambda: occupancy_of(page.dashboard.stage.setup.scenario.bus.schedule) == 0.5)
    settings = onlooker.state()["standing"]["settings"]
    assert (settings["occupancy"], settings["arbiter"]) == (0.5, "round-robin")
    steps_on(page, 3)
    # Half of the nodes speak in a cycle, and those that wait are heard in a later one.
    frames = page.dashboard.history.until(10**9, 2)
    cycles = [cycle for frame in frames for cycle in frame.cycles]
    assert all(len({frame.node for frame in cycle.frames}) == 4 for cycle in cycles)
    page.until(lambda: "4 frames" in page.text("bus-load"))
    page.press("Apply at the next step")
    page.until(lambda: page.has_told("Nothing to apply"))


def in_static(cycle) -> list[int]:
    return [frame.node for frame in cycle.frames if frame.segment == "static"]


def test_what_the_network_refuses_is_said_and_changes_nothing(page: Page, onlooker: Client):
    before = onlooker.state()["standing"]
    select(page, 5)
    page.press("restart")
    page.until(lambda: page.page.get_by_text("restart 5: the node is not out").count() > 0)
    assert page.page.get_by_text("Refused", exact=True).count() == 1
    assert onlooker.state()["standing"] == before
    assert page.text("alive") == "8 / 8"


def test_the_past_of_a_live_network_can_be_looked_at(page: Page):
    # Not every step before the network was slowed down has been shown.
    early = page.dashboard.history.until(10**9, 10**9)[3].step
    # The newest step, told to the field at the same moment, may take the place of what is typed.
    page.until(lambda: page.text("step") == str(early) or page.enter("Step", early))
    last = page.dashboard.history.last_step
    steps_on(page, 5)
    assert page.text("step") == str(early)
    cycle = page.dashboard.history.at(early).cycles[0].bus_cycle
    assert (
        cycle <= int(page.text("bus-cycle")) < cycle + len(page.dashboard.history.at(early).cycles)
    )
    page.press("Go live")
    page.until(lambda: int(page.text("step")) > last)


def test_the_console_is_clean(page: Page):
    assert page.console == []
