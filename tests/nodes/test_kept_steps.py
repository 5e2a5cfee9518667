"""Nodes of one process share the filtered steps of equal windows; no number depends on it."""

import dataclasses
from typing import Any

import pytest

from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.nodes.node_state import NodeConfig
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario


def alone(node: NodeConfig) -> NodeConfig:
    """The node with windows that it filters by itself."""
    estimator: Any = node.estimator
    own = dataclasses.replace(estimator.filter, kept=None)
    return dataclasses.replace(node, estimator=dataclasses.replace(estimator, filter=own))


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_shared_steps_are_those_of_a_node_alone(loss: float, monkeypatch: pytest.MonkeyPatch):
    setup = prepare(
        scenario("target-tracking", nodes=4, steps=16, rule="labelled", schedule="full", loss=loss)
    )
    updates: list[int] = []
    update = SigmaPointFilter.update

    def counted(*arguments: Any, **options: Any) -> Any:
        updates.append(1)
        return update(*arguments, **options)

    monkeypatch.setattr(SigmaPointFilter, "update", counted)

    def messages(nodes: list[NodeConfig]) -> tuple[list, int]:
        updates.clear()
        recorder = MemoryRecorder()
        in_process.run(build_environment(setup), nodes, recorder)
        return recorder.messages, len(updates)

    shared, few = messages([build_node(setup, node) for node in range(4)])
    again, none = messages([build_node(setup, node) for node in range(4)])
    by_themselves, many = messages([alone(build_node(setup, node)) for node in range(4)])
    assert shared == by_themselves == again
    # Each reading is taken four times by nodes alone, and once at best.
    assert few < many / 2 and none <= few
