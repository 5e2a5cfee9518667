"""Placement: the rule of the TRACK scenario, followed to the letter."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from concord.plants.placement import place_sensors, site_text, sites
from concord.topology.analysis import components
from concord.topology.geometric_graphs import geometric

pytestmark = pytest.mark.slow


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
        (
            (3, 1000.0, 5.0),
            "0 placements of the first 10000 seeds are connected, .* raise the range, shrink",
        ),
        ((3, -1.0), "area_side_m is -1.0"),
        ((3, 10.0, math.nan), "radio_range_m is nan"),
        ((3, 1000.0, 330.0, -1), "placement -1: must be 0 or more"),
    ],
)
def test_impossible_placements_are_refused_with_a_cure(arguments, message):
    with pytest.raises(ValueError, match=message):
        place_sensors(*arguments)


@given(st.integers(2, 12), st.integers(0, 4))
@settings(deadline=None, max_examples=15)
def test_drawings_are_the_connected_networks_in_the_order_of_their_seeds(nodes, drawing):
    connected = [
        positions
        for seed in range(2000)
        for positions in [np.random.default_rng(seed).uniform(0, 1000, (nodes, 2))]
        if len(components(geometric(positions, 600.0))) == 1
    ]
    np.testing.assert_array_equal(place_sensors(nodes, 1000.0, 600.0, drawing), connected[drawing])


@given(
    arrays(
        float,
        st.tuples(st.integers(1, 6), st.just(2)),
        elements=st.floats(-1e6, 1e6, allow_nan=False),
    )
)
def test_sites_are_read_as_they_were_written(positions):
    np.testing.assert_array_equal(sites(site_text(positions), len(positions)), positions)


def test_a_file_of_sites_has_a_line_for_each_node(tmp_path):
    (tmp_path / "sites.csv").write_text("# x, y in m\n100, 200.5\n\n-3,4\n")
    word = site_text(f"file:{tmp_path / 'sites.csv'}")
    np.testing.assert_array_equal(sites(word, 2), [[100.0, 200.5], [-3.0, 4.0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n3;4\n", "line 2: '3;4' is no site; give two finite numbers"),
        ("1,2\n1,inf\n", "line 2: '1,inf' is no site"),
        ("# nothing\n", "has no site; write a line x, y for each node"),
    ],
)
def test_a_file_without_sites_is_refused_by_its_line(tmp_path, text, message):
    (tmp_path / "sites.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        site_text(f"file:{tmp_path / 'sites.csv'}")


@pytest.mark.parametrize(
    ("word", "nodes", "message"),
    [
        ("at:1/2;3/4", 3, "2 sites, and the network 3 nodes"),
        ("here", 3, "'here': is neither the number of a drawing"),
        ("at:1/2;3", 2, "site 1: '3' is no site"),
    ],
)
def test_a_word_that_gives_no_sites_is_refused(word, nodes, message):
    with pytest.raises(ValueError, match=message):
        sites(word, nodes)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.csv: cannot be read"):
        site_text(f"file:{tmp_path / 'none.csv'}")
