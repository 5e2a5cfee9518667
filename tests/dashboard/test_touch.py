"""Changes by the hand: what a ray meets, what is offered there, and the script of it all."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.dashboard.panels.table import status
from concord.dashboard.theme import DARK
from concord.dashboard.touch.actions import actions, drawn_link, moved_node
from concord.dashboard.touch.ghosts import moves_of, places_of
from concord.dashboard.touch.picking import pick
from concord.dashboard.touch.script import as_option, script_of
from concord.nodes.commands import in_words
from concord.runtime.drivers import in_memory
from tests.dashboard.runs import frames_of, run_of, setup_of

CHANGES = (
    "3 kill 5", "4 cut 0 1", "5 cut 2 1 one-way", "6 loss 0.2 3 4", "7 loss 0.1", "8 restart 5",
    "9 corrupt 0.05 1 2", "10 lie 3 5 4", "11 heal 0 1", "12 set rule=wac rounds=2", "14 calm",
    "15 set rounds=1",
)  # fmt: skip


def script_after(changes: tuple[str, ...]) -> tuple[list[str], list[tuple[str, bytes]]]:
    run = run_of("target-tracking", nodes=8, steps=18, graph="ring", changes=changes)
    return script_of(event for frame in run.frames for event in frame.events), run.messages


def test_the_script_of_a_run_gives_the_same_run():
    script, messages = script_after(CHANGES)
    assert script == list(CHANGES)
    again = in_memory(
        setup_of("target-tracking", nodes=8, steps=18, graph="ring", changes=tuple(script))
    )
    assert again == messages
    assert as_option(script[:2]) == '--changes "3 kill 5" "4 cut 0 1"'


def test_a_partition_is_told_link_by_link():
    script, messages = script_after(("3 partition 0 1",))
    assert sorted(script) == ["3 cut 2 1", "3 cut 7 0"]
    # The links are announced in another order, and nothing else differs.
    told = [[one for one in run if one[0].startswith(("estimate", "share"))] for run in
            (messages, script_after(tuple(script))[1])]  # fmt: skip
    assert told[0] and told[0] == told[1]


RUN = run_of("target-tracking", nodes=8, steps=6, graph="ring", changes=("2 kill 5", "2 cut 1 2"))
SEEN = np.array([0.0, 0.0, 30.0])


@given(st.integers(0, 7), st.floats(0, 2 * np.pi), st.floats(0, 1.2))
def test_a_ray_that_passes_close_to_a_node_meets_it(node: int, turn: float, off: float):
    at, radius = RUN.stage.in_scene(RUN.stage.positions(0), 0.15), 0.4
    aside = np.array([np.cos(turn), np.sin(turn), 0.0]) * off * radius
    picked = pick(SEEN, at[node] + aside - SEEN, at, RUN.stage.edges, radius)
    assert picked is not None
    near = np.linalg.norm(at[picked.nodes[0]] - at[node])
    assert picked.nodes == (node,) or near < 2.8 * radius


@pytest.mark.parametrize("link", range(8))
def test_a_ray_at_the_middle_of_a_link_meets_it_or_what_covers_it(link: int):
    turn = 2 * np.pi * np.arange(8) / 8
    at = 8 * np.stack([np.cos(turn), np.sin(turn), np.zeros(8)], axis=-1)
    ends = RUN.stage.edges[link]
    middle = at[ends].mean(axis=0)
    picked = pick(SEEN, middle - SEEN, at, RUN.stage.edges, 0.4)
    assert picked is not None and picked.nodes == tuple(ends)
    assert pick(SEEN, np.array([0.0, 0.0, 1.0]), at, RUN.stage.edges, 0.4) is None
    assert pick(SEEN, np.array([50.0, 0.0, -30.0]), at, RUN.stage.edges, 0.4) is None


@pytest.mark.parametrize(
    ("nodes", "labels"),
    [((3,), "kill"), ((5,), "restart"), ((1, 2), "heal"), ((2, 3), "cut")],
)
def test_each_action_is_a_command_about_what_was_touched(nodes: tuple[int, ...], labels: str):
    offered = actions(RUN.frames[-1], nodes)
    assert labels in offered
    for words in offered.values():
        command = in_words(words.split())
        assert [set(ends) for ends in places_of(msgspec.to_builtins(command), set())] == [{*nodes}]


def test_a_drawn_link_cuts_heals_or_is_a_new_one():
    assert drawn_link(RUN.frames[-1], (2, 1)) == "heal 2 1"
    assert drawn_link(RUN.frames[-1], (2, 3)) == "cut 2 3"
    new = drawn_link(RUN.frames[-1], (4, 0))
    command = msgspec.to_builtins(in_words(new.split()))
    edges = {*map(tuple, RUN.frames[-1].stage.edges.tolist())}
    # The ghost of what waits is the new link alone.
    assert places_of(command, edges) == [(0, 4)]
    run = run_of("target-tracking", nodes=8, steps=6, graph="ring", changes=(f"3 {new}",))
    before, after = run.frames[2:4]
    assert {*map(tuple, before.stage.edges.tolist())} == edges
    assert {*map(tuple, after.stage.edges.tolist())} == {*edges, (0, 4)}
    assert drawn_link(after, (4, 0)) == "cut 4 0"
    assert len(after.ages) == len(after.cut) * 2 == 18
    assert {tuple(ends) for ends in after.stage.heard[after.ages == 0]} >= {(0, 4), (4, 0)}
    assert "target-tracking, 9 links, ci" in status(after.stage, DARK, after, "PAUSED")
    (told,) = after.events
    assert told.text == "set graph one of 9 links" and f"3 {told.words}" == f"3 {new}"


def test_a_link_is_drawn_beside_those_that_wait():
    waiting = [msgspec.to_builtins(in_words(drawn_link(RUN.frames[-1], (4, 0)).split()))]
    both = msgspec.to_builtins(in_words(drawn_link(RUN.frames[-1], (6, 2), waiting).split()))
    edges = {*map(tuple, RUN.frames[-1].stage.edges.tolist())}
    assert places_of(both, edges) == [(0, 4), (2, 6)]


def test_a_moved_node_stands_elsewhere_and_the_page_follows_it():
    place = RUN.frames[-1].stage.in_scene(np.array([480.0, 310.0]), 0.15)
    words = moved_node(RUN.frames[-1], 3, place)
    assert words == "set placement=3@480.0/310.0"
    run = run_of(
        "target-tracking", nodes=8, steps=6, graph="ring", changes=(f"3 {words}", "4 set rounds=2")
    )
    before, after, last = (run.frames[step] for step in (2, 3, 5))
    moves = [msgspec.to_builtins(in_words(event.words.split())) for event in after.events]
    ((node, where),) = moves_of(moves[0], before.stage)
    assert node == 3 and where.tolist() == [480, 310]
    for frame in (after, last):
        assert frame.stage.positions(frame.step)[3].tolist() == [480, 310]
        assert moves_of(moves[0], frame.stage) == []
    # The scene keeps its ground.
    stays = np.arange(8) != 3
    assert np.array_equal(before.stage.positions(2)[stays], last.stage.positions(5)[stays])
    assert "placement sites of 8 sensors" in after.events[0].text


def test_the_chart_of_nis_follows_a_node_that_a_hand_has_moved():
    """No script says so: the page hears of the move from the network alone."""
    changes = ("3 set placement=3@480/310",)
    run = run_of("target-tracking", nodes=8, steps=8, graph="ring", changes=changes)
    unscripted = run_of("target-tracking", nodes=8, steps=8, graph="ring").stage
    for told, scripted in zip(frames_of(unscripted, run.messages), run.frames, strict=True):
        assert told.scores.nis is not None and scripted.scores.nis is not None
        assert np.array_equal(told.scores.nis.squares, scripted.scores.nis.squares)
        assert told.scores.central == scripted.scores.central < 60
