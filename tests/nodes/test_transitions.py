"""The tables of transitions against what the machines do: no transition leads elsewhere."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.schedule import hybrid
from concord.filters.gaussian import Gaussian
from concord.nodes import environment, node
from concord.nodes.changes import Gone
from concord.nodes.environment_state import EnvironmentPhase
from concord.nodes.messages import Allowed, Bid, BidsClosed, EnvironmentEvent, Estimate, StepClosed
from concord.nodes.node_state import Phase
from tests.experiments.support import small
from tests.nodes.changing import run
from tests.nodes.networks import network, ring

STEPS, NODES, ROUNDS = 3, 4, 1
Seen = set[tuple[str, str, str]]


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> Iterator[Seen]:
    """Transitions that nodes make from here on, as (phase, event or condition, phase)."""
    made: Seen = set()

    def noted(phase: Phase, name: str, act: Callable[..., Any], leads_to: tuple[Any, ...]):
        def do(*arguments: Any) -> Any:
            after = act(*arguments)
            assert after.phase in leads_to, f"{phase}, {name}: leads to {after.phase}"
            made.add((phase.value, name, after.phase.value))
            return after

        return do

    for phase, row in node.TRANSITIONS.items():
        for event, one in row.items():
            handle = noted(phase, event.__name__, *one)
            monkeypatch.setitem(row, event, one._replace(handle=handle))
    for phase, completions in node.COMPLETIONS.items():
        told = tuple(
            one._replace(go_on=noted(phase, one.is_due.__name__, one.go_on, one.leads_to))
            for one in completions
        )
        monkeypatch.setitem(node.COMPLETIONS, phase, told)
    yield made


def test_every_phase_says_what_becomes_of_every_event():
    for table, phases in ((node.TRANSITIONS, Phase), (environment.TRANSITIONS, EnvironmentPhase)):
        assert set(table) == set(phases)
        events = [set(row) for row in table.values()]
        assert all(row == events[0] for row in events)
    assert set(node.COMPLETIONS) == set(Phase)


def test_nodes_make_the_transitions_of_their_table(seen: Seen):
    """A bus with contenders, a change of settings, an end and a return: all completions happen."""
    setup = small(schedule="hybrid", occupancy=0.5, nodes=5)
    run(setup, "3 kill 1", "5 restart 1", "8 set rounds=2")
    conditions = {(phase, what) for phase, what, _ in seen}
    for phase, completions in node.COMPLETIONS.items():
        assert {(phase.value, one.is_due.__name__) for one in completions} <= conditions
    assert ("shares", "has_all_shares", "finished") in seen
    assert ("shares", "has_all_shares", "grant") in seen


def _estimate(index: int, step: int) -> Estimate:
    return Estimate(index, step, [0.0], [1.0], [], {})


NODE, STEP = st.integers(0, NODES), st.integers(0, STEPS)
EVENTS: st.SearchStrategy[EnvironmentEvent] = st.one_of(
    st.builds(Allowed, st.integers(0, STEPS + 1)),
    st.builds(_estimate, NODE, STEP),
    st.builds(Bid, NODE, STEP, st.one_of(st.none(), st.integers(0, 3)), st.just(30)),
    st.builds(BidsClosed, STEP, st.just(0)),
    st.builds(StepClosed, STEP),
    st.builds(Gone, st.integers(0, NODES - 1)),
)


@given(st.lists(EVENTS, max_size=40), st.integers(1, STEPS))
@settings(max_examples=120)
def test_the_environment_makes_the_transitions_of_its_table(
    events: list[EnvironmentEvent], lead: int
):
    priors = [Gaussian(np.zeros(1), np.eye(1))] * NODES
    schedule = hybrid(NODES, 0.5)
    config = network(
        ring(NODES), priors, steps=STEPS, rounds=ROUNDS, lead=lead, schedule=schedule
    ).environment
    state = environment.begin(config)
    for event in events:
        before = environment.phase_of(config, state)
        row = environment.TRANSITIONS[before][type(event)]
        state, _ = environment.step(config, state, event)
        after = environment.phase_of(config, state)
        assert after in row.leads_to, f"{before}, {type(event).__name__}: leads to {after}"
