"""The sensors of all nodes as one, against each node's own."""

import numpy as np
import pytest

from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.local_filter import SensorGroup
from concord.plants.oscillator import ScalarSensor
from concord.plants.range_bearing import RangeBearing

NODES = 5


def _positions(rng):
    return RangeBearing(rng.normal(size=(NODES, 2)) * 100)


def _rows(rng):
    return ScalarSensor(rng.normal(size=(NODES, 2)), rng.uniform(1, 2, size=NODES))


class _OnlyAllAtOnce:
    """A sensor that cannot be that of single nodes."""

    gate = None

    def __init__(self, sensor):
        self._sensor = sensor
        self.measure, self.residual, self.interpret = (
            sensor.measure,
            sensor.residual,
            sensor.interpret,
        )


@pytest.mark.parametrize("wrap", [lambda sensor: sensor, _OnlyAllAtOnce])
@pytest.mark.parametrize(("make", "n", "m"), [(_positions, 4, 2), (_rows, 2, 1)])
def test_readings_of_chosen_sources_are_those_of_each_node(make, n, m, wrap):
    rng = np.random.default_rng(3)
    sensor = make(rng)
    everyone = AllSensors((SensorGroup(slice(None), wrap(sensor)),), NODES, (1, m))
    sources = rng.integers(NODES, size=(6, 3))
    states = rng.normal(size=(7, 6, n))
    found = everyone.of(sources).measure(states, 0)
    assert found.shape == (7, 6, 3, m)
    for lane, place in np.ndindex(*sources.shape):
        own = sensor.for_node(int(sources[lane, place]))
        expected = [own.measure(state, 0) for state in states[:, lane]]
        np.testing.assert_allclose(found[:, lane, place], expected, rtol=1e-12)
