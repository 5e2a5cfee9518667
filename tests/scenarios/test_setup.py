"""A setup is plain data from which any process builds the same network."""

import msgspec
import numpy as np
import pytest

from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definitions
from concord.scenarios.preparation import fingerprint
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from tests.experiments.support import scenario, small

# Another value for every field of a scenario that changes what is computed.
OTHER = {
    "nodes": 5,
    "graph": "complete",
    "weights": "maximum-degree",
    "rule": "wac",
    "rounds": 2,
    "steps": 13,
    "seed": 2,
    "run": 1,
    "number": "float32",
    "decay": 0.25,
    "hold": "drop",
    "determinant_weights": False,
}


def through_json(setup: Setup) -> Setup:
    return msgspec.json.decode(msgspec.json.encode(setup), type=Setup)


@pytest.mark.parametrize("changes", [{}, {"graph": "star"}, {"number": "float32"}])
def test_a_setup_that_travelled_builds_the_same_network(changes: dict):
    setup = small(**changes)
    travelled = through_json(setup)
    assert travelled == setup
    assert fingerprint(travelled) == fingerprint(setup)
    assert in_memory(travelled) == in_memory(setup)


@pytest.mark.parametrize("field", OTHER)
def test_the_fingerprint_tells_any_difference(field: str):
    plain = small(graph="path")
    assert fingerprint(plain) == fingerprint(small(graph="path"))
    assert fingerprint(small(**{"graph": "path", field: OTHER[field]})) != fingerprint(plain)


@pytest.mark.parametrize("graph", ["ring", "star", "complete", "path"])
def test_weights_come_with_their_neighbours(graph: str):
    setup = small(nodes=6, graph=graph)
    matrix = np.zeros((6, 6))
    for i, (heard, weights) in enumerate(zip(setup.neighbours, setup.weights, strict=True)):
        assert heard == sorted(heard)
        assert i not in heard
        matrix[i, [i, *heard]] = weights
        assert all(i in setup.neighbours[j] for j in heard)
    np.testing.assert_allclose(matrix.sum(axis=0), 1, atol=1e-12)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_array_equal(matrix, matrix.T)


def test_a_misspelt_field_is_refused():
    data = msgspec.json.encode(msgspec.to_builtins(scenario()) | {"seeed": 3})
    with pytest.raises(msgspec.ValidationError, match="seeed"):
        msgspec.json.decode(data, type=Scenario)


def test_every_scenario_says_what_it_is():
    for name, definition in definitions().items():
        assert definition.defaults.name == name
        assert 10 < len(type(definition.defaults.plant).summary()) < 100
        assert type(definition.defaults.plant).summary()[0].isupper()
