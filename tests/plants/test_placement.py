"""Placement: the rule of the TRACK scenario, followed to the letter."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.plants.placement import place_sensors
from concord.topology.analysis import components
from concord.topology.geometric_graphs import geometric


@given(
    st.one_of(
        st.tuples(st.integers(1, 25), st.just(330.0)),
        st.tuples(st.integers(1200, 1600), st.floats(50.0, 60.0)),
    )
)
@settings(deadline=None, max_examples=25)
def test_positions_are_those_of_the_first_seed_whose_network_is_connected(asked):
    nodes, radio_range_m = asked
    seed = 0
    while True:
        positions = np.random.default_rng(seed).uniform(0, 1000, (nodes, 2))
        if len(components(geometric(positions, radio_range_m))) == 1:
            break
        seed += 1
    np.testing.assert_array_equal(place_sensors(nodes, 1000.0, radio_range_m), positions)


def test_thousands_are_placed_without_the_distances_of_all_pairs():
    tracemalloc.start()
    place_sensors(4000)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 4000**2, "a byte for each pair is too much"


def test_area_and_range_scale_together():
    np.testing.assert_allclose(place_sensors(20, 100.0, 33.0), place_sensors(20) / 10)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0,), "at least 1"),
        ((3, 1000.0, 5.0), "first 10000 seeds is connected; raise the range, shrink the area"),
        ((3, -1.0), "area_side_m is -1.0"),
        ((3, 10.0, math.nan), "radio_range_m is nan"),
    ],
)
def test_impossible_placements_are_refused_with_a_cure(arguments, message):
    with pytest.raises(ValueError, match=message):
        place_sensors(*arguments)
