"""Compare each change with a network that has the same effect for another reason."""

from functools import partial

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from concord.filters.gaussian import Gaussian
from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.changes import (
    UNCHANGED,
    Cut,
    Event,
    Fault,
    Gone,
    Healed,
    Joined,
    Left,
    Loss,
    PaceChange,
    Set,
    after,
)
from concord.nodes.commands import Configure
from concord.nodes.estimator import EarlierBelief
from concord.nodes.history import AbsentSteps, Epoch, history_of
from concord.nodes.messages import CycleClosed, Estimate, Measured, ShareHeard, to_wire
from concord.nodes.node import initial_state
from concord.nodes.run_controller import ProcessStarter, RunController
from concord.results.records.trace import Trace
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import complete_settings, prepare
from concord.scenarios.setup import Setup
from tests.experiments.support import scenario, small
from tests.nodes.changing import run, same_bits
from tests.nodes.networks import last_come, shuffled
from tests.nodes.one_node import ROUNDS, heartbeat, middle_node, share

STEPS = 16


def ring(**changes) -> Setup:
    return small(**{"nodes": 5, "graph": "ring", "steps": STEPS, **changes})


def others(trace: Trace, node: int) -> Trace:
    """The trace without a node."""
    kept = [i for i in range(trace.mean.shape[1]) if i != node]
    return trace._replace(
        mean=trace.mean[:, kept], cov=trace.cov[:, kept], ages=trace.ages[:, kept][:, :, kept]
    )


@pytest.mark.parametrize("hold", ["decayed", "drop"])
@pytest.mark.parametrize("schedule", [{}, {"schedule": "hybrid", "occupancy": 0.6}])
def test_who_leaves_is_to_the_others_like_one_whose_links_are_cut(hold: str, schedule: dict):
    setup = ring(hold=hold, **schedule)
    left = run(setup, "6 kill 2")
    assert left.steps == STEPS
    assert np.isnan(left.mean[6:, 2]).all()
    assert not np.isnan(left.mean[:6]).any()
    assert (left.payload_bytes[6:, :, 2] == 0).all()
    if not schedule:
        # With a dynamic segment the node that is cut off still wins slots from the others.
        cut = run(setup, "6 cut 2 1", "6 cut 2 3")
        assert same_bits(others(left, 2), others(cut, 2))
    assert not same_bits(others(left, 2), others(run(setup), 2))


@pytest.mark.parametrize("relay", [False, True])
def test_nobody_waits_for_a_grant_that_no_bid_will_ask_for(relay: bool):
    """All contenders are out and come back; in lockstep a wait without a grant would never end."""
    setup = small(nodes=3, steps=STEPS, schedule="hybrid", occupancy=0.6, rule="labelled",
                  relay=relay)  # fmt: skip
    assert build_node(setup, 0).schedule.contenders(0) == (2,)
    closed: list[CycleClosed] = []

    def watch(_config: object, event: object, _state: object) -> None:
        if isinstance(event, CycleClosed):
            closed.append(event)

    trace = run(setup, "3 kill 2", "8 restart 2", watch=watch)
    assert trace.steps == STEPS
    assert not closed
    # A node that is back wins slots again.
    assert trace.payload_bytes[8:, :, 2].any()


def test_loss_that_is_set_at_once_is_the_loss_of_the_scenario():
    assert same_bits(run(ring(), "0 loss 0.4"), run(ring(loss=0.4)))
    everywhere = [f"0 loss 0.4 {i} {(i + 1) % 5}" for i in range(5)]
    assert same_bits(run(ring(), *everywhere), run(ring(loss=0.4)))


@pytest.mark.parametrize("same", ["rule=ci", "rounds=3", "occupancy=1"])
def test_setting_what_is_set_changes_nothing_where_nothing_is_held(same: str):
    """Fusion begins again from the present belief; with fresh shares alone it makes no difference,
    wherever the cycles of the next step begin."""
    setup = ring(hold="drop")
    assert same_bits(run(setup, f"5 set {same}"), run(setup))


def test_settings_from_the_first_step_on_are_those_of_another_scenario():
    changed = run(ring(), "0 set rule=hcmci rounds=2 occupancy=0.6 schedule=hybrid")
    other = run(ring(rule="hcmci", rounds=2, occupancy=0.6, schedule="hybrid"))
    assert same_bits(changed, other)


@pytest.mark.parametrize("rule", ["ci", "hcmci", "labelled", "kcf", "icf"])
def test_a_network_goes_on_under_any_rule(rule: str):
    """Rounds grow and shrink, and rules follow each other: estimates stay near the truth."""
    trace = run(ring(), f"4 set rule={rule} rounds=5", "7 set rounds=1", "10 set rule=ci rounds=2")
    assert trace.steps == STEPS
    assert (trace.published.sum((1, 2)) == [15] * 4 + [25] * 3 + [5] * 3 + [10] * 6).all()
    assert np.abs(trace.mean - trace.truth[:, None])[8:].max() < 2
    assert all(counts.keys() <= {"sent", "heard"} for counts in trace.counters)


def test_who_comes_back_begins_with_its_neighbours_belief():
    """Cut off at once, it predicts and updates that belief alone."""
    setup = ring()
    trace = run(setup, "6 kill 2", "11 restart 2", "11 cut 2 1", "11 cut 2 3")
    assert np.isnan(trace.mean[6:11, 2]).all()
    config = build_node(setup, 2)
    assert config.rebuild is not None
    belief = Gaussian(trace.mean[10, 1], trace.cov[10, 1])
    alone = config.rebuild(UNCHANGED, 11, EarlierBelief(belief, 10)).estimator
    content = alone.start()
    for step in range(11, STEPS):
        measured = Measured(2, step, to_wire(trace.readings[step, 2]))
        content, _ = alone.begin_step(content, measured)
        np.testing.assert_allclose(trace.mean[step, 2], alone.belief(content).mean, rtol=1e-9)
        np.testing.assert_allclose(trace.cov[step, 2], alone.belief(content).cov, rtol=1e-9)


@pytest.mark.parametrize("again", [3, 5])
def test_who_needs_a_neighbour_that_comes_back_too_is_told_what_that_believed(again: int):
    """At once where the neighbour left in the same step, else one step later."""
    setup = prepare(scenario("oscillator", nodes=4, graph="path", steps=10))
    trace = run(setup, "3 kill 1", "3 kill 0", f"{again} restart 1", f"{again} restart 0")
    out = np.isnan(trace.mean[..., 0])
    assert np.flatnonzero(out[:, 1]).tolist() == list(range(3, again))
    assert np.flatnonzero(out[:, 0]).tolist() == ([] if again == 3 else [3, 4, 5])


def test_a_dynamic_segment_serves_again_after_all_who_may_ask_were_out():
    bus = {"schedule": "hybrid-leaves", "occupancy": 0.5, "rounds": 1, "stretch": 100.0}
    setup = prepare(scenario("oscillator", nodes=3, graph="path", steps=8, **bus))
    trace = run(setup, "2 kill 1", "5 restart 1")
    assert trace.published[:, 0, 1].tolist() == [True] * 2 + [False] * 3 + [True] * 3
    assert all("missed" not in counters for counters in trace.counters)


LINES = st.sampled_from([
    ["3 kill 1", "9 restart 1"], ["4 kill 0", "4 kill 2", "8 restart 2", "8 restart 0"],
    ["5 cut 1 2", "9 heal 1 2"], ["2 cut 3 4 one-way"], ["6 loss 0.3"], ["6 loss 0.6 1 2 one-way"],
    ["4 set rule=hcmci rounds=2"], ["7 set rounds=5 occupancy=0.5"], ["9 set rule=labelled"],
    ["3 set hold=drop", "10 set rounds=1"],
])  # fmt: skip


@given(st.lists(LINES, min_size=1, max_size=3), st.integers(0, 2**32 - 1))
@example(
    [["3 kill 1", "9 restart 1"], ["4 set rule=hcmci rounds=2"], ["3 set hold=drop"]], 0
)  # A setting from before that the new rule does not have.
@settings(max_examples=3)
def test_any_order_of_arrival_gives_the_same_bits(lines: list[list[str]], order: int):
    script = [line for some in {tuple(one) for one in lines} for line in some]
    killed = [line.split()[2] for line in script if "kill" in line]
    if len(killed) != len(set(killed)):
        return
    setup = ring(steps=12)
    plain = run(setup, *script)
    assert plain.steps == 12
    for pick in (shuffled(order), last_come):
        assert same_bits(run(setup, *script, pick=pick), plain)


# --- what stands ---------------------------------------------------------------------------------


def test_changes_add_up():
    standing = UNCHANGED
    for change in (
        Left(3), Gone(1), Joined(3), Cut(1, 2), Cut(0, 1), Healed(1, 2), Loss(0.5), Loss(0.1, 1, 2),
        Loss(0.2, 1, 2), Set({"rounds": 2}, 30), PaceChange(True, 0),
    ):  # fmt: skip
        standing = after(standing, 10, change)
    assert standing.absent == (1,)
    assert standing.cuts == ((0, 1),)
    assert (standing.loss, standing.losses) == (0.5, ((1, 2, 0.2),))
    assert (standing.settings, standing.first_step, standing.first_cycle) == ({"rounds": 2}, 10, 30)


def test_a_history_knows_who_was_in_and_where_a_cycle_belongs():
    events = [(4, Left(1)), (6, Joined(1)), (8, Gone(1)), (5, Set({"rounds": 2}, 15))]
    history = history_of(3, [Event(step, change) for step, change in events])
    assert history.epochs == (Epoch(0, 0, 3), Epoch(5, 15, 2))
    assert history.absent_steps == (AbsentSteps(1, 4, 6), AbsentSteps(1, 8, None, "gone"))
    slow = [(2, Fault("slow-cpu", (1,), (200.0,))), *events]
    asked = history_of(3, [Event(step, change) for step, change in slow]).absent_steps
    assert [one.why for one in asked] == ["asked", "asked"]
    assert [history.is_in(1, step) for step in range(3, 10)] == [1, 0, 0, 1, 1, 0, 0]
    assert [history.place(cycle) for cycle in (0, 14, 15, 16, 17)] == [
        (0, 0), (4, 2), (5, 0), (5, 1), (6, 0),
    ]  # fmt: skip


def test_who_was_missed_is_not_waited_for_after_a_change():
    """A node has died unasked; then something else changes."""
    config = build_node(ring(), 1)
    state = state_machine.initial_state(config)
    state, _ = state_machine.step(config, state, Gone(2))
    state, _ = state_machine.step(config, state, Measured(1, 0, [[None]], None, (Cut(0, 1),)))
    config, state, _ = node_changes.apply(config, state)
    assert state.absent == {2}
    assert state_machine.awaited_neighbours(config, state)[0] == 0
    ends = state_machine.step(config, state, Measured(1, 1, [[None]]))[0]
    assert ends.absent == {2}


def test_rounds_that_no_step_had_are_not_in_the_history():
    first, second, third = (
        Event(step, Set({"rounds": rounds}, 2 * step)) for step, rounds in [(0, 2), (4, 9), (4, 1)]
    )
    assert history_of(5, [first]).rounds == 2
    assert history_of(5, [first, second, third]).rounds == 2
    assert history_of(5, [first, second]).rounds == 9


def test_who_was_told_of_a_return_after_the_end_goes_on_when_told_of_the_end_again():
    """An end is told past what waits in queues, so a return that was told first may come last."""
    config = middle_node()
    state = initial_state(config)
    state, _ = state_machine.step(config, state, Gone(0))
    state, _ = state_machine.step(config, state, replace(heartbeat(0), changes=(Joined(0),)))
    config, state, _ = node_changes.apply(config, state)
    for cycle in range(ROUNDS):
        frame = share(config, 2, cycle)
        state, _ = state_machine.step(config, state, ShareHeard(2, frame))
    assert state_machine.awaited_neighbours(config, state) == [0]
    state, messages = state_machine.step(config, state, Gone(0))
    assert [message.step for message in messages if isinstance(message, Estimate)] == [0]


TURNS = st.lists(
    st.tuples(st.integers(0, 2), st.sampled_from(["left", "gone", "joined"]), st.integers(-3, 4)),
    max_size=30,
)


@given(TURNS, st.integers(0, 40))
def test_members_are_those_that_left_and_did_not_return(turns: list, since: int):
    """In real time a node may be given up from a step that is over."""
    kinds, events, spans, step = {"left": Left, "gone": Gone, "joined": Joined}, [], [], 0
    for node, kind, later in turns:
        step = max(step + later, 0)
        events.append(Event(step, kinds[kind](node)))
        if kind != "joined":
            spans.append([node, step, 99])
        for span in spans if kind == "joined" else ():
            if span[0] == node and span[2] == 99:
                span[2] = step
    history = history_of(3, events)
    for node in range(3):
        out = {at for one, first, end in spans if one == node for at in range(first, end)}
        members = [at not in out for at in range(60)]
        assert [history.is_in(node, at) for at in range(60)] == members
        shorter = history.since(since)
        assert [shorter.is_in(node, at) for at in range(since, 60)] == members[since:]


@pytest.mark.parametrize(
    ("name", "states", "asked", "stands"),
    [
        ("oscillator", 2, ({"rule": "hcmci"}, {"rounds": 2}), {"rule": "hcmci", "rounds": 2}),
        # A sensor that moves while another move waits does not send the other one back.
        ("target-tracking", 5, ({"placement": "0@1/2"}, {"placement": "1@3/4"}),
         {"placement": "at:1.0/2.0;3.0/4.0;"}),
    ],
)  # fmt: skip
def test_settings_that_wait_for_the_same_step_all_hold(
    name: str, states: int, asked: tuple[dict, ...], stands: dict
):
    setup = small(name, steps=40, nodes=4, graph="complete")
    starter = ProcessStarter(lambda _: None, lambda _: True, partial(complete_settings, setup))
    controller = RunController(build_environment(setup), (), starter)
    controller.begin()
    for one in asked:
        controller.command(Configure(one))
    for step, node in np.ndindex(controller.state.released, 4):
        size = states * (states + 1) // 2
        controller.take(Estimate(node, step, [0.0] * states, [0.0] * size, [], {}))
    found = controller.state.standing.settings
    assert found.keys() == stands.keys()
    assert all(str(found[key]).startswith(str(value)) for key, value in stands.items())
