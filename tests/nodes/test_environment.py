"""Test the environment's state machine: its lead, its grants, and the plant's inputs."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.arbitration import Arbiter
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import Schedule, dynamic_only
from concord.filters.gaussian import Gaussian
from concord.nodes import environment, environment_changes
from concord.nodes.changes import Gone, Joined, Left, Welcome
from concord.nodes.environment_state import ControlStep, EnvironmentConfig, EnvironmentState
from concord.nodes.messages import (
    Allowed,
    Bid,
    EnvironmentMessage,
    Estimate,
    Grant,
    Measured,
    Truth,
    decode,
    from_wire,
)
from concord.scenarios.build import build_environment
from tests.experiments.support import small
from tests.nodes.networks import DECAYED, Outcome, network, path, random_priors, ring, run

PRIOR = Gaussian(np.zeros(1), np.eye(1))


def started(config: EnvironmentConfig) -> tuple[EnvironmentState, list[EnvironmentMessage]]:
    """Return an environment that may go on without limit."""
    return environment.step(config, environment.begin(config), Allowed(config.steps))


def world_of(
    nodes: int, steps: int, lead: int, schedule: Schedule | None = None
) -> EnvironmentConfig:
    return network(
        path(nodes), [PRIOR] * nodes, steps=steps, rounds=2, lead=lead, schedule=schedule
    ).environment


def estimate(node: int, step: int) -> Estimate:
    return Estimate(node, step, [0.0], [1.0], [], {})


@given(st.integers(1, 4), st.integers(1, 6), st.integers(1, 5), st.randoms(use_true_random=False))
def test_the_lead_is_never_exceeded_and_every_step_is_sent_once(
    nodes: int, steps: int, lead: int, random
):
    config = world_of(nodes, steps, lead)
    state, messages = started(config)
    sent = list(messages)
    reached = [0] * nodes
    while not environment.finished(config, state):
        assert state.completed == min(reached)
        assert state.released == min(steps, state.completed + lead)
        # Any node may be the next to finish the step that it was given.
        able = [i for i in range(nodes) if reached[i] < state.released]
        node = random.choice(able)
        state, messages = environment.step(config, state, estimate(node, reached[node]))
        reached[node] += 1
        sent += messages
    truths = [m.step for m in sent if isinstance(m, Truth)]
    assert truths == list(range(steps))
    heartbeats = [(m.step, m.node) for m in sent if isinstance(m, Measured)]
    assert heartbeats == [(k, i) for k in range(steps) for i in range(nodes)]


@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_the_lead_changes_no_number_of_an_undriven_plant(one: int, other: int, seed: int):
    priors = random_priors(np.random.default_rng(seed), 3, 2)
    outcomes = [
        run(network(ring(3), priors, steps=5, rounds=2, seeing=[0, 1], lead=lead, seed=seed % 100))
        for lead in (one, other)
    ]
    assert outcomes[0].same_bits(outcomes[1])


# --- grants --------------------------------------------------------------------------------------


def granted(config: EnvironmentConfig, bids: list[Bid]) -> tuple[list[Grant], EnvironmentState]:
    """Return the environment's grants and state when these bids arrive in this order."""
    state, _ = started(config)
    grants = []
    for bid in bids:
        state, messages = environment.step(config, state, bid)
        grants += [m for m in messages if isinstance(m, Grant)]
    return grants, state


@settings(max_examples=30)
@given(st.lists(st.one_of(st.none(), st.integers(0, 3)), min_size=4, max_size=4))
def test_grants_do_not_depend_on_the_order_of_bids(urgencies: list[int | None]):
    config = world_of(4, 2, 2, dynamic_only(4, 0.5))
    bids = [Bid(node, 0, urgency, 30) for node, urgency in enumerate(urgencies)]
    asking = [node for node in range(4) if urgencies[node] is not None]
    best = sorted(asking, key=lambda node: (-(urgencies[node] or 0), node))[:2]
    for order in permutations(bids):
        grants, _ = granted(config, list(order))
        assert grants == [Grant(0, sorted(best))]


def test_an_arbiter_that_believes_the_order_still_gives_the_same():
    """Even one that serves whichever request it is handed first, as it is handed them by node."""
    first = Arbiter(lambda state, bids, frame_ids: np.arange(len(bids)))
    config = world_of(3, 1, 1, dynamic_only(3, 0.3))
    config = replace(config, bus=TimelessBus(config.schedule, 30, first))
    for order in permutations([Bid(node, 0, 1, 30) for node in range(3)]):
        assert granted(config, list(order))[0] == [Grant(0, [0])]


def test_bids_for_a_later_cycle_wait_for_their_turn():
    """Cycle 1 was closed without a grant everywhere before the last bid for cycle 0 arrived."""
    config = world_of(2, 2, 2, dynamic_only(2, 0.5))
    early = [Bid(0, 0, 9, 30), Bid(0, 1, 5, 30), Bid(1, 1, 6, 30), Bid(1, 0, 2, 30)]
    grants, state = granted(config, early)
    assert grants == [Grant(0, [0]), Grant(1, [1])]
    assert state.bids == {}


def test_cycles_in_which_nobody_may_contend_need_no_bids():
    """Contention in every third cycle only."""
    schedule = Schedule(2, ((),), ((0, 1), (0, 1), (0, 1)), (0, 0, 1))
    config = world_of(2, 3, 3, schedule)
    state, _ = started(config)
    assert state.next_cycle == 2
    grants, state = granted(config, [Bid(0, 2, 1, 30), Bid(1, 2, 2, 30)])
    assert grants == [Grant(2, [1])]
    assert state.next_cycle == 5


# --- the closed loop -----------------------------------------------------------------------------

GROWTH, GAIN, STEPS = 1.2, 0.9, 60


def driven(node: int | None, lead: int = 1, nodes: int = 3, gain: float = GAIN) -> Outcome:
    """An unstable plant x -> 1.2 x + u + w under u = -0.9 of what `node` believes."""
    controller = ControlStep(lambda x, memory, step: (-gain * x, memory), None, node)
    return run(
        network(
            path(nodes),
            [PRIOR] * nodes,
            steps=STEPS,
            rounds=2,
            matrix=np.array([[GROWTH]]),
            process_noise_cov=np.array([[0.01]]),
            hold_policy=DECAYED,
            seeing=[0],
            lead=lead,
            controller=controller,
            seed=3,
        )
    )


def truth_of(outcome: Outcome) -> np.ndarray:
    found = [decode(t, d) for t, d in outcome.messages if t == "truth"]
    return np.array([from_wire(m.state) for m in found])


def controls_of(outcome: Outcome) -> list[np.ndarray | None]:
    found = [decode(t, d) for t, d in outcome.messages if t == "measured/0"]
    return [None if m.control is None else np.array(m.control) for m in found]


def test_what_drives_the_plant_is_the_estimate_of_the_step_before():
    outcome = driven(node=1)
    truth, controls = truth_of(outcome), controls_of(outcome)
    noise = 0.1 * np.random.default_rng(3).standard_normal((STEPS, 1))
    assert controls[0] is None
    for k in range(STEPS - 1):
        control = controls[k + 1]
        assert control is not None
        np.testing.assert_array_equal(control, -GAIN * outcome.mean[k, 1])
        np.testing.assert_allclose(truth[k + 1], GROWTH * truth[k] + control + noise[k], rtol=1e-12)


def test_a_controller_that_sees_the_truth_may_run_ahead():
    for lead in (1, 4):
        outcome = driven(node=None, lead=lead)
        truth, controls = truth_of(outcome), controls_of(outcome)
        for k in range(STEPS - 1):
            control = controls[k + 1]
            assert control is not None
            np.testing.assert_array_equal(control, -GAIN * truth[k])
    assert driven(node=None).same_bits(driven(node=None, lead=4))


def test_a_loop_through_the_estimates_needs_a_lead_of_one():
    with pytest.raises(AssertionError, match="lead = 1"):
        driven(node=0, lead=2)


def test_who_is_gone_again_before_its_first_step_is_not_told_to_have_returned():
    """The others hear of its end at once; told of its return after that, they would wait for it."""
    config = world_of(nodes=3, steps=4, lead=1)
    state, _ = environment.step(config, environment.begin(config), Allowed(1))
    state, _ = environment.step(config, state, Gone(1))
    for node in (0, 2):
        state, _ = environment.step(config, state, estimate(node, 0))
    config, state, _ = environment_changes.apply(config, state, [Joined(1, [0.0], [1.0])])
    state, _ = environment.step(config, state, Gone(1))
    state, messages = environment.step(config, state, Allowed(config.steps))
    heartbeats = [message for message in messages if isinstance(message, Measured)]
    assert [message.node for message in heartbeats] == [0, 2]
    assert [message.changes for message in heartbeats] == [(Gone(1, 0), Gone(1, 1))] * 2
    for node in (0, 2):
        state, _ = environment.step(config, state, estimate(node, 1))
    assert state.completed == 2


def test_a_node_that_joins_hears_of_changes_after_its_welcome():
    """Both nodes return before the same step; the first was welcomed while the second was out."""
    config = build_environment(small(nodes=4, graph="ring", steps=6))
    state, _ = environment.step(config, environment.begin(config), Allowed(1))
    for change in (Left(1), Left(3)):
        config, state, _ = environment_changes.apply(config, state, [change])
    told = []
    for node in (1, 3):
        config, state, outbox = environment_changes.apply(config, state, [Joined(node)])
        told += [one for one in outbox if isinstance(one, Welcome)]
    assert [one.standing.absent for one in told] == [(3,), ()]
    state = state._replace(completed=1)
    _, messages = environment.step(config, state, Allowed(2))
    changes = {one.node: one.changes for one in messages if isinstance(one, Measured)}
    assert changes[1] == (Joined(3),)
    assert changes[3] == ()
    assert changes[0] == (Left(1), Left(3), Joined(1), Joined(3))
