"""A node that takes a member for out is found by its estimate, and corrected by a heartbeat."""

from concord.nodes import environment, node_changes
from concord.nodes import node as state_machine
from concord.nodes.changes import Event, Gone, Joined, Left, Present
from concord.nodes.messages import EnvironmentMessage, Estimate, Measured
from concord.nodes.node_state import Phase
from concord.nodes.run_controller import ProcessStarter, RunController
from concord.scenarios.build import build_environment, build_node
from tests.experiments.support import small

NODES = 4
SETUP = small(steps=40, nodes=NODES, graph="complete")


def controller() -> RunController:
    """Return a run controller that has begun."""
    starter = ProcessStarter(lambda node: None, lambda node: True, lambda before, asked: before)
    found = RunController(build_environment(SETUP), (), starter)
    found.begin()
    return found


def estimate(node: int, step: int, *absent: int) -> Estimate:
    return Estimate(node, step, [0.0] * 2, [1.0, 0.0, 1.0], [], {}, absent=absent)


def take_step(run: RunController, step: int, *absent: int) -> list[EnvironmentMessage]:
    """Have all members estimate a step; node 1 takes some for out."""
    messages = []
    for node in environment.members(run.config, run.state):
        messages += run.take(estimate(node, step, *(absent if node == 1 else ())))
    return messages


def said(messages: list[EnvironmentMessage]) -> list[Event]:
    return [one for one in messages if isinstance(one, Event) and isinstance(one.change, Present)]


def test_a_false_absence_is_told_with_the_next_heartbeat_and_once():
    run = controller()
    first = run.state.released
    messages = take_step(run, 0, 2)
    assert said(messages) == [Event(first, Present(2, 1))]
    heartbeats = [one for one in messages if isinstance(one, Measured)]
    assert {one.step for one in heartbeats} == {first}
    assert [one.changes for one in heartbeats] == [(Present(2, 1),)] * NODES
    # Estimates of steps that began before that heartbeat say nothing new.
    later = [said(take_step(run, step, 2)) for step in range(1, first + 1)]
    assert later[:-1] == [[]] * (first - 1) and len(later[-1]) == 1
    assert run.state.standing.absent == ()


def test_no_true_absence_is_doubted():
    """Of a death, from the first estimate on; of a return, as long as heartbeats may be late."""
    run = controller()
    run.take(Gone(2))
    assert [said(take_step(run, step, 2)) for step in range(6)] == [[]] * 6
    run.ready(2)
    step = 6
    while 2 not in run.state.since:
        assert not said(take_step(run, step, 2))
        step += 1
    returned = run.state.since[2]
    found = [step for step in range(step, returned + 10) if said(take_step(run, step, 2))]
    assert found[0] == returned + 8


def test_a_stranger_among_the_names_is_left_alone():
    run = controller()
    assert said(take_step(run, 0, 9, 700)) == []


def test_the_mistaken_node_waits_for_its_neighbour_again_and_counts_it():
    config = build_node(SETUP, 1)
    state, _ = state_machine.step(config, state_machine.initial_state(config), Gone(2))
    assert state.absent == {2}
    changes = (Present(2, 1), Present(3, 0), Left(0))
    state, _ = state_machine.step(config, state, Measured(1, 0, [[None]], None, changes))
    assert state.phase is Phase.CHANGE
    config, state, _ = node_changes.apply(config, state)
    assert (state.absent, state.counters["falsely absent"]) == ({0}, 1)
    assert 2 in state_machine.awaited_neighbours(config, state)


def test_other_nodes_keep_an_end_that_they_have_heard_of():
    """The node died after the heartbeat that corrects another, which comes later."""
    config = build_node(SETUP, 3)
    state, _ = state_machine.step(config, state_machine.initial_state(config), Gone(2))
    heartbeat = Measured(3, 0, [[None]], None, (Present(2, 1), Joined(0)))
    state, _ = state_machine.step(config, state, heartbeat)
    _, state, _ = node_changes.apply(config, state)
    assert state.absent == {2} and "falsely absent" not in state.counters
