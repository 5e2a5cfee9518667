"""A bus whose settings change while it runs, and panels that fail: the page goes on."""

import logging
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.dashboard.app import Dashboard
from concord.dashboard.frames.assembler import BusView
from concord.dashboard.frames.frame import BusCycle, StepFrame
from concord.dashboard.frames.source import SourceState
from concord.dashboard.frames.stage import restaged
from concord.dashboard.panels.timeline import TimelineView
from concord.dashboard.panels.timeline_marks import BAR, LEFT, RIGHT, ROW, TOP, WIDTH
from concord.dashboard.serve import open_network, open_recording
from concord.dashboard.theme import DARK
from concord.runtime.drivers import drive
from concord.runtime.recording import McapRecorder
from tests.dashboard.runs import frames_of, run_of, setup_of

RUN = run_of("target-tracking", nodes=8, steps=12)
AFTER = restaged(RUN.stage, {"occupancy": 0.5, "schedule": "hybrid"})
SILENT = 6


def cycles() -> tuple[BusCycle, BusCycle]:
    """Return a cycle in which a node was silent, and one after a change to shorter cycles."""
    size = {node: 100 for node in range(RUN.stage.nodes) if node != SILENT}
    before = BusView(RUN.stage.bus).cycle(4, size, {})
    owners = AFTER.bus.schedule.static_senders(5)
    return before, BusView(AFTER.bus).cycle(5, dict.fromkeys(owners, 100), {})


def test_the_node_owned_a_slot_before_the_change_and_owns_none_after():
    before, after = cycles()
    assert before.silent == (SILENT,)
    assert SILENT not in AFTER.bus.schedule.static_senders(before.cycle)
    assert AFTER.bus.cycle_us < RUN.stage.bus.cycle_us
    assert (before.bus, after.bus) == (RUN.stage.bus, AFTER.bus)


def test_a_past_cycle_is_drawn_with_its_own_timetable_and_to_the_same_scale():
    before, after = cycles()
    frame = frames_of(RUN.stage, RUN.messages)[-1]._replace(cycles=(after,))
    html = TimelineView(AFTER).draw(DARK, frame, [before], after, 0.0, None)
    start_us, end_us = RUN.stage.bus.own_slot_us(SILENT, before.cycle)
    scale = (WIDTH - LEFT - RIGHT) / RUN.stage.bus.cycle_us
    y = TOP + BAR + 12
    expected = (LEFT + scale * start_us, scale * (end_us - start_us) - 0.7)
    paths = [path for path in re.findall(r'<path d="([^"]*)" fill=', html) if f" {y:g}h" in path]
    boxes = [
        (float(x), float(wide))
        for path in paths
        for x, wide in re.findall(rf"M([\d.]+) {y:g}h([\d.]+)v{ROW - 2:g}", path)
    ]
    assert any(box == pytest.approx(expected, abs=0.1) for box in boxes)
    # Frames of both cycles lie in the panel, at the same pixels per microsecond.
    assert max(x + wide for x, wide in boxes) <= WIDTH - RIGHT + 0.1
    own = [float(x) for x in re.findall(r'<g class="slot".*?<rect x="([\d.]+)"', html)]
    assert own == pytest.approx([LEFT + scale * f.start_us for f in after.frames], abs=0.1)


def test_past_cycles_show_the_frames_that_were_missed_and_rejected():
    run = run_of("target-tracking", nodes=8, steps=12, changes=("3 loss 0.3", "6 corrupt 0.4"))
    frames = run.frames
    assert not any(cycle.missed or cycle.rejected for f in frames[:3] for cycle in f.cycles)
    past = [cycle for frame in frames for cycle in frame.cycles]
    # A node holds an older share than the frame that it missed.
    for frame in frames:
        lost = {int(sender) for sender in run.stage.heard[frame.lost, 1]}
        assert lost == set(frame.cycles[-1].missed)
        counted = frame.traffic.rejected.sum()
        before = frames[frame.step - 1].traffic.rejected.sum() if frame.step else 0
        assert bool(frame.cycles[-1].rejected) == (counted > before)
    assert sum(len(cycle.missed) for cycle in past) > 20
    shown = past[-12:]
    html = TimelineView(run.stage).draw(DARK, frames[-1], shown[-2::-1], shown[-1], 0.0, None)
    marks = re.findall(r'class="missed" d="([^"]*)"', html)
    assert sum(mark.count("M") for mark in marks) == sum(len(c.missed) for c in shown[:-1])
    assert html.count('class="rejected"') == sum(bool(c.rejected) for c in shown[:-1]) > 0


def test_a_run_that_is_changed_after_a_kill_keeps_the_bus_of_each_cycle():
    run = run_of(
        "target-tracking",
        nodes=8,
        steps=12,
        changes=("4 kill 6", "8 set occupancy=0.5 schedule=hybrid"),
    )
    frames = run.frames
    schedules = [frame.cycles[0].bus.schedule.static_table for frame in frames]
    assert schedules[:8] == 8 * [RUN.stage.bus.schedule.static_table]
    assert schedules[8:] == 4 * [AFTER.bus.schedule.static_table]
    assert frames[7].cycles[-1].silent == (SILENT,)
    # The newest stage draws every past cycle, whatever its schedule was.
    view = TimelineView(run.stage)
    for frame in frames:
        past = [
            cycle for one in frames for cycle in one.cycles if cycle.cycle < frame.cycles[0].cycle
        ]
        assert view.draw(DARK, frame, past[::-1], frame.cycles[0], 0.0, None).count("<svg") == 1


def test_a_page_on_a_recording_shows_the_settings_of_the_shown_step(tmp_path: Path):
    changes = ("3 set occupancy=0.5 schedule=hybrid", "5 set rule=hcmci", "7 set rounds=5")
    setup = setup_of("target-tracking", nodes=8, steps=12, changes=changes)
    recorder = McapRecorder(
        tmp_path / "run.mcap", setup.scenario.rounds, setup.time_step_s, SHARE_FRAMES
    )
    drive(setup, recorder, lambda _: None)
    recorder.close()
    page = open_recording(setup, tmp_path / "run.mcap", "127.0.0.1", 0, light=False)
    try:
        # To the end and back: a step of the past keeps its own settings.
        shown_steps = ((1, "ci, 3 rounds"), (11, "hcmci, 5 rounds"), (4, "ci, 3 rounds"))
        for number, (step, words) in enumerate(shown_steps):
            page.inputs.alter(lambda view, step=step: view.look_at(step))
            turns(page, 10.0 * (number + 1), 3)
            assert f", {words}<" in page.controls.status.content
            shown = page.history.at(step).cycles[-1].bus
            assert f"cycle {shown.cycle_us / 1e3:.4g} ms" in page.page._bus.content
            assert ("DYNAMIC" in page.page._bus.content) == (step >= 3)
            assert page._shown().stage.rounds == int(words.split()[1])
    finally:
        page.close()


class Script:
    """A live source that gives prepared frames, one at a poll."""

    live = takes_commands = True

    def __init__(self, frames: list[StepFrame]) -> None:
        self.stage = RUN.stage
        self.frames = list(frames)
        self.state = SourceState("RUNNING")

    def poll(self) -> list[StepFrame]:
        return [self.frames.pop(0)] if self.frames else []

    def pace(self) -> SourceState:
        return self.state

    def ask(self, command):
        raise AssertionError(command)

    def close(self) -> None:
        self.frames.clear()


@pytest.fixture
def page() -> Iterator[Dashboard]:
    source: object = Script(frames_of(RUN.stage, RUN.messages))
    shown = open_network(source, None, "127.0.0.1", 0, light=False)  # type: ignore[arg-type]
    yield shown
    shown.close()


def turns(page: Dashboard, first_s: float, count: int) -> None:
    for number in range(count):
        page.tick(first_s + number)


@pytest.mark.parametrize(
    ("panel", "where"),
    [
        ("Bus", "_timeline.draw"),
        ("Scene", "scene.draw"),
        ("Charts", "charts.draw"),
        ("One state", "_state_charts.draw"),
    ],
)
def test_one_panel_that_fails_is_named_and_the_others_go_on(
    page: Dashboard,
    panel: str,
    where: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
):
    turns(page, 1.0, 2)
    owner = getattr(page.page, where.partition(".")[0])

    def fails(*_: object, **__: object) -> None:
        raise ValueError("min() <arg> is empty")

    monkeypatch.setattr(owner, "draw", fails)
    with caplog.at_level(logging.ERROR):
        turns(page, 10.0, 5)
    status = page.controls.status.content
    assert f"{panel} cannot be drawn: ValueError: min() &lt;arg&gt; is empty" in status
    assert status.count("cannot be drawn") == 1
    # Drawn five times, told once.
    assert [record.getMessage() for record in caplog.records] == [
        f"{panel} cannot be drawn; the other panels go on"
    ]
    assert f'data-testid="step">{page.history.last_step}<' in status
    assert page.history.last_step == 6
    drawn = re.search(r'data-testid="bus-cycle">(\d+)<', page.page._bus.content)
    assert drawn
    newest = {cycle.bus_cycle for cycle in page.history.at(6).cycles}
    assert (int(drawn[1]) in newest) == (panel != "Bus")
    monkeypatch.undo()
    turns(page, 20.0, 2)
    assert "cannot be drawn" not in page.controls.status.content


def test_a_change_of_the_view_that_fails_does_not_end_the_page(page: Dashboard):
    turns(page, 1.0, 2)
    page.inputs.alter(lambda view: view.speed / 0.0 if view.speed else None)
    turns(page, 10.0, 1)
    assert page.failures.sentences() == [
        "The page cannot be drawn: ZeroDivisionError: float division by zero"
    ]
    turns(page, 11.0, 2)
    assert page.failures.sentences() == []
