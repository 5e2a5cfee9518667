"""`concord flexray plan` and `show`: what fits is the most that fits, and rehearsals are true."""

import re
import shlex
from itertools import combinations

import numpy as np
import pytest
import tyro
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.dynamic_segment import walk
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.experiments.scenario_flags import ScenarioFlags, resolved
from concord.features.flexray_tools.commands.plan_report import run_command, slot_rows
from concord.features.flexray_tools.commands.rehearsal import (
    alternatives,
    changed,
    prepare_without_bus,
    rehearse,
)
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.schedules import occupancy_of
from tests.experiments.command_support import concord, refused
from tests.experiments.test_bus_report import SMALL

pytestmark = pytest.mark.slow

_SHARES = ("--rule", "ci", "--number", "float64")
ASKED = (
    "flexray", "plan", "--scenario", "target-tracking", "--nodes", 20, *_SHARES, "--cluster", "audi"
)  # fmt: skip
WHOLE = (*ASKED, "--schedule", "full")


def test_what_does_not_fit_is_said_and_the_most_that_does_is_shown(capsys):
    said = concord(capsys, *WHOLE, "--json")
    answer = said.json()
    assert said.code == 0
    # A share of 5 + 15 float64 takes 7 frames of 34 bytes; 20 nodes need 140 of the 51 slots.
    assert "140" in answer["problem"] and "51" in answer["problem"]
    assert answer["asked"]["bus"]["schedule"] == {"type": "full"}
    shown = answer["shown"]
    assert shown == answer["alternatives"][0]
    assert shown["shares_per_cycle"] == max(a["shares_per_cycle"] for a in answer["alternatives"])
    assert shown["fits_time"] and shown["figures"]["starved"] == []
    assert {row["node"] for row in shown["slots"]} == set(range(20))


def test_the_plan_reads_as_a_table(capsys):
    said = concord(capsys, *WHOLE)
    assert said.code == 0
    text = said.out
    asked, wrong, shown = (text.index(w) for w in ("asked for", "does not fit", "shown below"))
    assert asked < wrong < shown
    assert "NOT what was asked for" in text and "concord run --scenario target-tracking" in text
    assert "frame IDs" in text and "measurement to estimate" in text


def test_a_long_slot_table_is_cut_for_people_alone(capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("concord.features.flexray_tools.commands.plans.MOST_PRINTED_ROWS", 4)
    rows = concord(capsys, *WHOLE, "--json").json()["shown"]["slots"]
    assert len(rows) > 4
    text = concord(capsys, *WHOLE).out
    assert f"{len(rows) - 4} more rows of the slot table; --json has them all" in text
    assert len(re.findall(r"(?m)^ *\d+ │ (?:static|dynamic)", text)) == 4


def test_what_fits_is_shown_as_asked(capsys):
    answer = concord(capsys, *ASKED, "--occupancy", 0.25, "--json").json()
    assert answer["problem"] is None and answer["alternatives"] == []
    assert answer["shown"]["schedule"] == "dynamic" and answer["shown"]["occupancy"] == 0.25
    assert answer["shown"]["published"] == pytest.approx(0.25)
    text = concord(capsys, *ASKED, "--occupancy", 0.25).out
    assert "fits; shown below: what was asked for" in text


def test_a_fixed_priority_starves_those_behind_it(capsys):
    """The occupancy is no cap: the segment holds 11 shares, so the first 11 send in each cycle."""
    asked = (*ASKED, "--schedule", "dynamic", "--occupancy", 0.25)
    answer = concord(capsys, *asked, "--arbiter", "minislot", "--json").json()
    assert answer["shown"]["figures"]["starved"] == list(range(11, 20))
    assert answer["shown"]["published"] == 11 / 20
    fair = concord(capsys, *asked, "--json").json()
    assert fair["shown"]["figures"]["starved"] == []
    assert fair["shown"]["published"] < 0.25 + 1e-9


def test_the_price_of_urgency_classes_is_told(capsys):
    asked = (*ASKED, "--schedule", "dynamic", "--occupancy", 0.1)
    answer = concord(capsys, *asked, "--json").json()["shown"]
    assert answer["urgency_classes"] == 8
    owned = [row["frame_ids"] for row in answer["slots"]]
    assert owned == [[52 + node + 20 * k for k in range(8)] for node in range(20)]
    # All IDs before that of the last winner but those of the winners.
    assert 0 < answer["figures"]["empty_minislots_max"] <= 8 * 20 - 2
    text = concord(capsys, *asked).out
    assert "8 urgency classes of 20 frame IDs, for which at most 158 empty minislots" in text
    assert "52, 72, ... 192" in text
    few = concord(capsys, *asked, "--urgency-classes", 2, "--json").json()["shown"]["figures"]
    assert few["empty_minislots_max"] < answer["figures"]["empty_minislots_max"]


def test_a_crowded_dynamic_segment_is_admitted(capsys):
    # A frame takes 21 minislots, and each of 156 empty IDs takes one; frames begin by the 225th.
    for arbiter, room in (("minislot", 11), ("urgency", 4)):
        asked = (*ASKED, "--schedule", "dynamic", "--occupancy", 1, "--arbiter", arbiter)
        answer = concord(capsys, *asked, "--json").json()
        shown = answer["shown"]
        assert answer["problem"] is None
        assert shown["dynamic_slots"] == 20 and shown["dynamic_room"] == room
        assert room / 20 <= shown["published"] < 1
        assert f"only {room} of them fit" in concord(capsys, *asked).out


def test_cycles_longer_than_the_step_are_said_to_be(capsys):
    arguments = ("--scenario", "dc-motor-speed", "--cluster", "demo")
    answer = concord(capsys, "flexray", "plan", *arguments, "--json").json()
    assert not answer["shown"]["fits_time"] and "--stretch" in answer["shown"]["time"]
    stretched = concord(capsys, "flexray", "plan", *arguments, "--stretch", 3, "--json").json()
    assert stretched["shown"]["fits_time"]


def test_a_cluster_too_small_for_one_share_is_refused(tmp_path, capsys):
    path = tmp_path / "small.toml"
    path.write_text(cluster_to_toml(SMALL))
    said = concord(capsys, "flexray", "plan", *_SHARES, "--schedule", "full", "--cluster", path)
    assert "static slots" in refused(said)


# --- the most that fits ------------------------------------------------------------------------


def unplanned(nodes: int, cluster: str, number: str = "float64") -> Setup:
    options = scenario_of(
        scenario="oscillator", graph="ring", nodes=nodes, cluster=cluster, number=number, steps=4
    )
    return prepare_without_bus(options)


@settings(max_examples=20)
@given(
    st.integers(3, 120),
    st.sampled_from(["audi", "bosch", "flexray-adapter", "demo", "fitted"]),
    st.sampled_from(["float64", "float32"]),
)
def test_one_share_more_does_not_fit(nodes: int, cluster: str, number: str):
    setup = unplanned(nodes, cluster, number)
    found = alternatives(setup)
    assert found
    sizes = [round(occupancy_of(other.setup.scenario.bus.schedule) * nodes) for other in found]
    assert sizes == sorted(sizes, reverse=True)
    for other, size in zip(found, sizes, strict=True):
        assert other.bus.dynamic_room() == max(other.bus.schedule.dynamic_slot_table)
        if size == nodes:
            continue
        more = changed(other.setup, occupancy=(size + 1) / nodes)
        try:
            plan = flexray(more)
        except ValueError:
            continue
        assert plan.dynamic_room() < max(plan.schedule.dynamic_slot_table)


@settings(max_examples=30)
@given(st.integers(3, 14), st.sampled_from(["audi", "flexray-adapter", "demo"]), st.data())
def test_dynamic_room_is_the_most_that_any_winners_fit(nodes: int, cluster: str, data):
    setup = changed(unplanned(nodes, cluster), schedule="dynamic", occupancy=1.0)
    try:
        plan = flexray(setup)
    except ValueError:
        return
    car = plan.cluster
    room = plan.dynamic_room()
    last = plan.table.classes - 1
    requests = [plan.table.request(node, last) for node in range(nodes)]

    def fits(count: int) -> bool:
        return all(not walk(car, some).waiting for some in combinations(requests, count))

    assert fits(room)
    assert room == nodes or not fits(room + 1)


def flexray(setup: Setup) -> FlexRayBus:
    bus = build_bus(setup)
    assert isinstance(bus, FlexRayBus)
    return bus


# --- slot tables and command lines ---------------------------------------------------------------


@settings(max_examples=40)
@given(st.integers(2, 30), st.floats(0.05, 1.0), st.sampled_from(["round-robin", "hybrid"]))
def test_the_shown_slots_are_those_of_the_schedule(nodes: int, occupancy: float, schedule: str):
    setup = changed(unplanned(nodes, "fitted"), schedule=schedule, occupancy=occupancy)
    plan = flexray(setup)
    rows = [row for row in slot_rows(plan.table) if row.segment == "static"]
    for cycle in range(2 * plan.schedule.period):
        sending = [row for row in rows if cycle % row.repetition == row.base_cycle]
        assert sorted(row.node for row in sending) == sorted(plan.schedule.static_senders(cycle))
        ids = [number for row in sending for number in row.frame_ids]
        assert len(ids) == len(set(ids))
        for row in sending:
            assert tuple(row.frame_ids) == tuple(s.frame_id for s in plan.slots(row.node, cycle)[0])


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "nodes": st.integers(2, 40),
            "graph": st.sampled_from(["ring", "4-regular", "edges:0>1;1>0"]),
            "occupancy": st.floats(0.01, 1.0),
            "schedule": st.sampled_from(["hybrid", "dynamic", "round-robin"]),
            "cluster": st.sampled_from(["audi", "my clusters/a.toml"]),
            "number": st.just("float32"),
            "determinant_weights": st.just(False),
            "seed": st.integers(0, 2**31),
            "stretch": st.floats(1, 50),
        },
    )
)
def test_the_command_line_means_the_scenario(options: dict):
    scenario = scenario_of(scenario="oscillator", **options)
    program, command, *words = shlex.split(run_command(scenario))
    assert (program, command) == ("concord", "run")
    assert resolved(tyro.cli(ScenarioFlags, args=words)) == scenario


# --- rehearsals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("schedule", "arbiter"),
    [
        ("round-robin", None),
        ("hybrid", "minislot"),
        ("hybrid", "round-robin"),
        ("dynamic", "minislot"),
        ("dynamic", "round-robin"),
    ],
)
@pytest.mark.parametrize("cluster", ["fitted", "bosch"])
def test_where_bids_do_not_matter_the_rehearsal_is_the_run(schedule, arbiter, cluster):
    options = scenario_of(
        scenario="oscillator", nodes=7, graph="ring", steps=5, occupancy=0.4, schedule=schedule,
        cluster=cluster, **({} if arbiter is None else {"arbiter": arbiter}),
    )  # fmt: skip
    setup = prepare(options)
    trace = read_trace(setup, in_memory(setup))
    rehearsal = rehearse(setup, flexray(setup), 5)
    np.testing.assert_array_equal(rehearsal.published, trace.published)
    np.testing.assert_array_equal(rehearsal.asked, trace.asked)


def test_under_growing_bids_the_longest_silent_go_first():
    setup = changed(unplanned(9, "demo"), schedule="dynamic", occupancy=1 / 3, arbiter="wtod")
    rehearsal = rehearse(setup, flexray(setup), 4)
    turns = rehearsal.published.reshape(-1, 9)
    assert (turns.sum(1) == 3).all()
    # Three of nine win: each node once in any three cycles, so no share gets older than two.
    assert all((turns[c : c + 3].sum(0) == 1).all() for c in range(len(turns) - 2))
    assert rehearsal.ages.max() == 2 and rehearsal.ages.min() == 0


def test_ages_of_a_rehearsal_by_hand():
    setup = changed(unplanned(3, "fitted"), schedule="round-robin", occupancy=1 / 3)
    rehearsal = rehearse(setup, flexray(setup), 2)
    # One node a cycle in turn, three cycles a step: after each step they are 2, 1 and 0 old.
    assert rehearsal.ages.tolist() == [[2, 1, 0], [2, 1, 0]]


# --- one cycle ---------------------------------------------------------------------------------

SHOWN = (
    "flexray",
    "show",
    "--scenario",
    "target-tracking",
    "--cluster",
    "audi",
    "--schedule",
    "hybrid",
    "--occupancy",
    0.25,
)


def test_a_cycle_is_drawn_frame_by_frame(capsys):
    drawn = concord(capsys, *SHOWN, "--cycle", 65).out
    frames = concord(capsys, *SHOWN, "--cycle", 65, "--json").json()
    # Round 2 of step 21: from cycle 4200 on the turn of cycle 63 is due in 4203.
    assert "round 2 of step 21: cycle 4205 (count 45)" in drawn
    assert (frames["bus_cycle"], frames["cycle_count"]) == (4205, 4205 % 64)
    assert frames["begins_us"] == 4205 * 5000
    assert all(f" ID {frame['frame_id']} " in drawn for frame in frames["frames"])
    assert drawn.count(" ID ") == len(frames["frames"]) > 0
    for name in ("static", "dynamic", "network idle time"):
        assert name in drawn
    ends = [frame["end_us"] for frame in frames["frames"]]
    starts = [frame["start_us"] for frame in frames["frames"]]
    assert all(end < start for end, start in zip(ends, starts[1:], strict=False))
    assert 0 < frames["load"] < 1


def test_only_cycles_of_the_run_can_be_shown(capsys):
    assert "0..359" in refused(concord(capsys, *SHOWN, "--cycle", 360))
    assert "0..359" in refused(concord(capsys, *SHOWN, "--cycle", -1))
    assert concord(capsys, *SHOWN, "--cycle", 359).code == 0
