"""SVG and HTML as text: what they show, to scale, escaped."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from concord.dashboard.digits import rounded
from concord.dashboard.explain.selected import selected_panel
from concord.dashboard.frames.conditions import conditions, oldest, sender_at
from concord.dashboard.frames.frame import LogEntry
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.panels.table import MOST_ROWS, chosen_rows, log, node_table, status
from concord.dashboard.panels.timeline import TimelineView
from concord.dashboard.panels.timeline_marks import LEFT, RIGHT, WIDTH, Axis, slot
from concord.dashboard.panels.zoom import SIZE, zoom
from concord.dashboard.theme import DARK, LIGHT, linear
from concord.dashboard.view import View
from tests.dashboard.runs import run_of, setup_of

RUN = run_of("target-tracking", nodes=8, steps=24, schedule="hybrid", occupancy=0.5)
FRAME = RUN.frames[-1]
EVIL = replace(RUN.stage, names=("<script>alert(1)</script>", *RUN.stage.names[1:]))


def svg(html: str) -> ElementTree.Element:
    """The drawing in a piece of HTML; it must be well formed."""
    found = re.search(r"<svg.*</svg>", html, re.DOTALL)
    assert found
    return ElementTree.fromstring(found.group())


def timeline(frame=FRAME, now_us: float = 0.0, selected: int | None = None, stage=RUN.stage) -> str:
    cycle = frame.cycles[-1]
    past = [c for f in RUN.frames for c in f.cycles][::-1]
    return TimelineView(stage).draw(DARK, frame, past, cycle, now_us, selected)


def boxes(html: str) -> dict[int, ElementTree.Element]:
    return {
        int(group.attrib["data-node"]): group.find("rect")
        for group in svg(html).iter("g")
        if "data-node" in group.attrib
    }  # type: ignore[return-value]


def test_frames_lie_to_scale_in_the_cycle():
    bus = RUN.stage.bus
    assert bus.has_time
    drawn = boxes(timeline())
    for frame in FRAME.cycles[-1].frames:
        x = LEFT + (WIDTH - LEFT - RIGHT) * frame.start_us / bus.cycle_us
        wide = (WIDTH - LEFT - RIGHT) * (frame.end_us - frame.start_us) / bus.cycle_us
        assert float(drawn[frame.node].attrib["x"]) == pytest.approx(x, abs=0.1)
        assert float(drawn[frame.node].attrib["width"]) == pytest.approx(wide, abs=0.8)


def test_frames_of_two_channels_do_not_cover_each_other():
    frame = FRAME.cycles[-1].frames[0]

    def extent(channel: str, channels: str) -> tuple[float, float]:
        sent = frame._replace(channel=channel)
        text = slot(Axis(RUN.stage.bus.cycle_us), DARK, "n", sent, "past", False, False, channels)
        rect = ElementTree.fromstring(text).find("rect")
        assert rect is not None
        top = float(rect.attrib["y"])
        return top, top + float(rect.attrib["height"])

    (first, middle), (other, last) = extent("A", "AB"), extent("B", "AB")
    assert first < middle <= other < last
    assert extent("AB", "AB") == extent("A", "A")
    assert extent("AB", "AB")[0] == first and extent("AB", "AB")[1] >= last


def test_the_frame_that_is_on_the_bus_has_a_colour_of_its_own():
    frames = FRAME.cycles[-1].frames
    middle = (frames[1].start_us + frames[1].end_us) / 2
    drawn = boxes(timeline(now_us=middle))
    fills = [drawn[frame.node].attrib["fill"] for frame in frames]
    assert fills.count("#e69f00") == 1
    assert fills[1] == "#e69f00"


def test_an_owner_that_is_silent_has_a_crossed_slot():
    cycle = FRAME.cycles[-1]
    owner = RUN.stage.bus.schedule.static_senders(cycle.cycle)[0]
    silent = cycle._replace(
        silent=(owner,), frames=tuple(f for f in cycle.frames if f.node != owner)
    )
    html = timeline(FRAME._replace(cycles=(*FRAME.cycles[:-1], silent)))
    assert f"node {RUN.stage.names[owner]}: silent" in html
    assert "silent</title>" not in timeline()


def test_the_beliefs_lie_around_the_truth():
    html = zoom(RUN.stage, LIGHT, FRAME, (0, 2), 3)
    drawing = svg(html)
    assert len(list(drawing.iter("ellipse"))) == RUN.stage.nodes + 1
    dots = [c for c in drawing.iter("circle") if "data-node" in c.attrib]
    assert len(dots) == RUN.stage.nodes
    for dot in dots:
        node = int(dot.attrib["data-node"])
        off = FRAME.belief.mean[node, [0, 2]] - FRAME.truth[[0, 2]]
        x, y = float(dot.attrib["cx"]) - SIZE / 2, SIZE / 2 - float(dot.attrib["cy"])
        # The same direction from the middle as in the plane.
        assert x * off[1] == pytest.approx(y * off[0], abs=0.06 * np.abs(off).max() + 1e-9)


def test_an_unknown_truth_is_no_picture_of_nan():
    blind = FRAME._replace(truth=np.full_like(FRAME.truth, np.nan))
    assert "nan" not in zoom(RUN.stage, DARK, blind, (0, 2), None).lower()
    assert "nan" not in node_table(RUN.stage, View(), blind).lower()


def test_the_table_tells_who_is_down_and_who_is_selected():
    view = View(selected=2)
    down = FRAME._replace(alive=np.arange(8) != 5)
    html = node_table(RUN.stage, view, down)
    rows = re.findall(r'<tr data-node="(\d+)" data-state="(\w+)"', html)
    assert [int(node) for node, _ in rows] == list(range(8))
    assert dict(rows)["5"] == "down"
    assert "DOWN" in html
    assert "DOWN" not in node_table(RUN.stage, view, FRAME)


def test_small_numbers_have_a_power_of_ten_in_the_heading():
    usual = node_table(RUN.stage, View(), FRAME)
    assert ">error</th>" in usual and ">3σ</th>" in usual
    scores = FRAME.scores._replace(error=1e-4 * FRAME.scores.error)
    belief = FRAME.belief._replace(cov=1e-8 * FRAME.belief.cov)
    small = node_table(RUN.stage, View(), FRAME._replace(scores=scores, belief=belief))
    assert ">error 10⁻³</th>" in small and ">3σ 10⁻³</th>" in small
    # The longest axis of the ellipse that the scene draws, of one standard deviation.
    states = list(RUN.stage.score.states)
    blocks = belief.cov[:, states][:, :, states]
    longest = np.sqrt([np.linalg.svd(block, compute_uv=False)[0] for block in blocks])
    numbers = re.findall(r'class="why"[^>]*>([^<]*)</td>', small)
    for shown, value in zip(numbers[1::2], 3e3 * longest, strict=True):
        assert float(shown) == pytest.approx(value, rel=5e-3)


def test_large_numbers_are_written_in_full():
    assert [rounded(value) for value in (0.00123456, 7.0, 999.6, 2284.0, 76543.0)] == [
        "0.00123", "7", "1000", "2280", "76\u202f500",
    ]  # fmt: skip
    assert (rounded(-7621.0, 2), rounded(3.2e7)) == ("-7600", "3.2e+07")
    scores = FRAME.scores._replace(error=2284 + 0 * FRAME.scores.error, rmse=2284.0)
    wrong = FRAME._replace(scores=scores)
    assert "e+" not in node_table(RUN.stage, View(), wrong) and "e+" not in status(
        RUN.stage, DARK, wrong, "PAUSED"
    )


def test_one_round_is_one_round():
    single = set_stage(setup_of("target-tracking", nodes=8, rounds=1))
    assert "ci, 1 round<" in status(single, DARK, None, "PAUSED")
    assert "ci, 3 rounds<" in status(RUN.stage, DARK, FRAME, "PAUSED")


def test_large_networks_show_the_worst_and_the_selected():
    error = np.arange(200.0)
    rows = chosen_rows(200, View(order="error", selected=0), error, np.zeros(200))
    assert rows[:3] == [199, 198, 197]
    assert rows[-1] == 0
    assert len(rows) == MOST_ROWS
    assert chosen_rows(3, View(order="age"), error[:3], np.array([1, 7, 3])) == [1, 2, 0]


@pytest.mark.parametrize("theme", [DARK, LIGHT])
def test_text_from_outside_is_escaped(theme):
    view = View(theme=theme, selected=0)
    told = LogEntry(3, "node <script>alert(2)</script> is down", 0, True)
    bad = FRAME._replace(rejection=("<script>x</script>",) * 8)
    pages = [
        node_table(EVIL, view, bad), log(theme, [told]), selected_panel(EVIL, view, [FRAME]),
        zoom(EVIL, theme, FRAME, (0, 2), 0), timeline(stage=EVIL),
        status(EVIL, theme, FRAME, "RUNNING", "<script>"),
    ]  # fmt: skip
    for page in pages:
        assert "<script" not in page
        assert "&lt;script" in page or "silent" in page


def test_conditions_name_the_most_serious():
    assert set(conditions(FRAME)) <= {"up", "blind"}
    lost = FRAME._replace(lost=np.arange(len(RUN.stage.heard)) == 0)
    assert conditions(lost)[RUN.stage.heard[0, 0]] == "stale"
    rejected = lost._replace(events=(LogEntry(23, "node 00 rejected a frame: crc", 0, True),))
    assert conditions(rejected)[0] == "rejected"
    assert conditions(rejected._replace(alive=np.zeros(8, bool))) == ["down"] * 8


def test_the_oldest_share_is_per_receiver():
    ages = np.arange(len(RUN.stage.heard))
    expected = [ages[RUN.stage.heard[:, 0] == node].max() for node in range(8)]
    assert oldest(FRAME._replace(ages=ages)).tolist() == expected


def test_the_cursor_meets_every_frame_of_every_cycle():
    seen = [sender_at(FRAME, cursor)[0] for cursor in np.arange(0.0, 3.0, 0.01)]
    for number, cycle in enumerate(FRAME.cycles):
        met = dict.fromkeys(seen[100 * number : 100 * number + 100])
        assert list(met) == [frame.node for frame in cycle.frames]


def test_linear_light_is_the_inverse_of_the_screen():
    assert linear((255, 0, 128)).tolist() == [255, 0, 55]


def test_the_cycle_is_numbered_by_the_time_of_the_bus():
    """The counter of the bus goes on between the steps."""
    bus, cycle = RUN.stage.bus, FRAME.cycles[-1]
    first_us = 1e6 * RUN.stage.setup.time_step_s * FRAME.step
    begins_us = cycle.bus_cycle * bus.cycle_us - (len(FRAME.cycles) - 1) * bus.cycle_us
    assert 0 <= begins_us - first_us < bus.schedule.period * bus.cycle_us
    html = timeline()
    assert f'data-testid="bus-cycle">{cycle.bus_cycle}<' in html
    in_step = sum(bus.load(one.frames) for one in FRAME.cycles) * bus.cycle_us
    over_all = 100 * in_step / (1e6 * RUN.stage.setup.time_step_s)
    assert f"({over_all:.2g} % of all)" in html
