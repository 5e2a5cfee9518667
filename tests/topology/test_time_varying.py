"""Links that come and go: one answer for numbers and arrays, and the law that the name promises."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.nodes.faults.losses import chance
from concord.topology.link_names import parse_links
from concord.topology.time_varying import bernoulli, in_range, markov, switching, wandering

KEY = (0x1234567, 0xFEDCBA9)
RING = [[1, 3], [0, 2], [1, 3], [0, 2]]
STAR = [[1, 2, 3], [0], [0], [0]]
HOMES = np.random.default_rng(1).uniform(0, 100, (4, 2))


def draw(step, one, other):
    return chance(KEY, np.add(step, 2), one, other)


LINKS = {
    "bernoulli": bernoulli(0.3, draw),
    "markov": markov(0.1, 0.2, draw),
    "markov to the full": markov(0.4, 0.6, draw),
    "switching": switching([RING, STAR], 3),
    "moving": in_range(wandering(HOMES, 30, 12, 60, draw), 50),
}


@pytest.mark.parametrize("name", LINKS)
@given(
    questions=st.lists(
        st.tuples(st.integers(0, 59), st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=9
    )
)
def test_numbers_and_arrays_have_one_answer_in_any_order(name, questions):
    up = LINKS[name]
    alone = [bool(up(*question)) for question in questions]
    steps, senders, receivers = (np.array(column) for column in zip(*questions, strict=True))
    assert up(steps, senders, receivers).tolist() == alone
    assert [bool(up(*question)) for question in reversed(questions)] == alone[::-1]


@pytest.mark.parametrize("name", LINKS)
def test_shapes_broadcast(name):
    grid = LINKS[name](np.arange(20)[:, None], np.array([0, 1]), np.array([1, 2]))
    assert grid.shape == (20, 2)
    assert grid[7, 1] == LINKS[name](7, 1, 2)


@pytest.mark.parametrize("name", ["bernoulli", "markov", "moving"])
def test_both_directions_share_one_fate(name):
    steps, one, other = (part.ravel() for part in np.indices((60, 4, 4)))
    up = LINKS[name]
    assert (up(steps, one, other) == up(steps, other, one)).all()


def test_bernoulli_links_fail_as_often_as_they_say_and_without_memory():
    steps, links = (part.ravel() for part in np.indices((400, 50)))
    up = bernoulli(0.3, draw)(steps, links * 2, links * 2 + 1).reshape(400, 50)
    assert abs(up.mean() - 0.7) < 5 * math.sqrt(0.21 / up.size)
    after_failure = up[1:][~up[:-1]].mean()
    assert abs(after_failure - 0.7) < 5 * math.sqrt(0.21 / (~up[:-1]).sum())


@pytest.mark.parametrize(("failure", "repair"), [(0.05, 0.2), (0.4, 0.6), (0.01, 0.99)])
def test_markov_links_have_the_chances_and_the_equilibrium_of_their_chain(failure, repair):
    steps, links = (part.ravel() for part in np.indices((300, 100)))
    up = markov(failure, repair, draw)(steps, links * 2, links * 2 + 1).reshape(300, 100)
    fell, rose = ~up[1:][up[:-1]], up[1:][~up[:-1]]
    for happened, probability in ((fell, failure), (rose, repair)):
        slack = 5 * math.sqrt(probability * (1 - probability) / len(happened))
        assert abs(happened.mean() - probability) < slack
    # In equilibrium from the first step on; the correlation of the chain widens the band.
    available = repair / (failure + repair)
    spread = math.sqrt(available * (1 - available) * 2 / (failure + repair))
    assert abs(up[:10].mean() - available) < 5 * spread / math.sqrt(up[:10].size)
    assert abs(up.mean() - available) < 5 * spread / math.sqrt(up.size)


def test_a_markov_state_follows_its_story_step_by_step():
    """The oracle walks forward from the beginning; the function looks back from the end."""
    failure, repair = 0.15, 0.3
    state = bool(draw(-1, 0, 1) < repair / (failure + repair))
    for step in range(200):
        drawn = draw(step, 0, 1)
        state = (drawn >= failure) if state else (drawn >= 1 - repair)
        assert markov(failure, repair, draw)(step, 0, 1) == state


def test_graphs_take_turns():
    up = switching([RING, STAR], 3)
    for step in range(14):
        graph = (RING, STAR)[step // 3 % 2]
        heard = [[j for j in range(4) if up(step, j, i)] for i in range(4)]
        assert heard == graph


def test_a_graph_without_links_has_its_turn_too():
    up = switching([RING, [[], [], [], []]], 1)
    assert up(0, 1, 0) and not up(1, 1, 0) and up(2, 1, 0)


def test_wanderers_stay_at_their_distance_and_come_round():
    places = wandering(HOMES, 30, 12, 25, draw)
    np.testing.assert_allclose(np.linalg.norm(places - HOMES, axis=-1), 30)
    np.testing.assert_allclose(places[12], places[0], atol=1e-9)
    assert len({tuple(place) for place in np.round(places[0] - HOMES, 6).tolist()}) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bernouli:0.1", "unknown links 'bernouli:0.1': did you mean 'bernoulli:P'"),
        ("bernoulli", "at least 0 and below 1; for example bernoulli:0.1"),
        ("bernoulli:1", "below 1"),
        ("bernoulli:often", "below 1"),
        ("markov:0.5", "together at most 1; for example markov"),
        ("markov:0.7,0.6", "together at most 1"),
        ("markov:0,0.5", "above 0"),
        ("switching:ring:5", "two graphs or more"),
        ("switching:ring,star", "steps that each stays"),
        ("switching:ring,star:0", "steps that each stays"),
        ("moving:0", "all above 0"),
        ("moving:300,50", "radius in m and period"),
        ("static:1", "takes no numbers"),
        ("measured:0.5", "takes no numbers"),
    ],
)
def test_links_that_cannot_be_are_refused_with_an_example(text, message):
    with pytest.raises(ValueError, match=message):
        parse_links(text)
