"""The belief with which a node comes back, where its neighbours are steps ahead or behind."""

import dataclasses

import numpy as np

from concord.nodes import environment, environment_changes, node_changes
from concord.nodes.changes import UNCHANGED, Gone, Joined, Welcome, after
from concord.nodes.messages import Allowed, Estimate
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.catalogue import definition_of
from tests.experiments.support import small


def test_a_belief_of_an_earlier_step_is_predicted_by_who_comes_back():
    """Steps 7 to 10 without readings and neighbours lie between the belief and the return."""
    setup = small(nodes=5, graph="ring", steps=16)
    config = build_node(setup, 2)
    assert config.rebuild is not None
    model = definition_of(setup.scenario).model(setup.scenario)
    transition = np.column_stack([model.transition(unit, None, 0) for unit in np.eye(2)])
    mean, cov = np.array([1.0, -0.5]), np.array([[0.3, 0.1], [0.1, 0.2]])
    standing = after(UNCHANGED, 11, Joined(2))
    joined = Joined(2, mean.tolist(), cov[np.triu_indices(2)].tolist(), step=6)
    late, _ = node_changes.begin_late(config, Welcome(2, 11, standing, joined))
    for _ in range(4):
        mean, cov = transition @ mean, transition @ cov @ transition.T + model.process_noise_cov(0)
    begun = late.estimator.belief(late.estimator.start())
    np.testing.assert_allclose(begun.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(begun.cov, cov, rtol=1e-9)


def test_the_newest_belief_of_a_neighbour_is_told_with_its_step():
    """In real time a node that hangs keeps steps open for long; others have gone on."""
    config = build_environment(small(nodes=5, graph="ring", steps=16))
    config = dataclasses.replace(config, lead=config.steps)
    state = environment.begin(config)
    state, _ = environment.step(config, state, Allowed(8))
    for step in range(6):
        for node in range(config.nodes):
            # Node 0 hangs from step 2 on, node 2 is the one that returns.
            if node != 2 and (node != 0 or step < 2):
                said = Estimate(node, step, [float(step), 0.0], [1.0, 0.0, 1.0], [], {})
                state, _ = environment.step(config, state, said)
    state, _ = environment.step(config, state, Gone(2))
    joined = environment_changes.joining(config, state, 2)
    assert joined is not None
    assert state.completed == 2
    assert (joined.step, joined.mean) == (5, [5.0, 0.0])
