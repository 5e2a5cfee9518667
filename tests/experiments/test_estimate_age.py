"""Ages that estimates reach before the next ones come, counted by hand and on a grid of time."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from concord.nodes.changes import Event, Gone, Joined
from concord.nodes.history import history_of
from concord.results.figures.timing_figures import peak_ages_s

NAN = np.nan
STEP_S = 0.1
ALL_IN = history_of(1, [])


def test_ages_by_hand():
    sent_s = np.array([[0.06, 0.06], [0.06, NAN], [0.2, NAN], [NAN, 0.07]])
    # Node 0: 0.1 + 0.06, 0.1 + 0.2, and two steps to the end; node 1: 0.3 + 0.07, and one step.
    found = peak_ages_s(sent_s, ALL_IN, STEP_S)
    np.testing.assert_allclose(found, [0.16, 0.3, 0.2, 0.37, 0.1])


def test_the_age_of_a_node_that_is_out_does_not_grow():
    sent_s = np.full((20, 1), NAN)
    sent_s[[0, 15], 0] = 0.06
    events = [Event(3, Gone(0)), Event(15, Joined(0))]
    np.testing.assert_allclose(peak_ages_s(sent_s, history_of(1, events), STEP_S), [0.3, 0.5])


@given(st.lists(st.floats(0.01, 0.09) | st.just(NAN), min_size=1, max_size=30))
def test_ages_are_those_that_an_onlooker_sees(sent: list[float]):
    """An onlooker looks every millisecond at the newest estimate there is."""
    steps = len(sent)
    came_s = [(k * STEP_S + age_s, k) for k, age_s in enumerate(sent) if np.isfinite(age_s)]
    largest_s = 0.0
    for now_s in np.arange(0, steps * STEP_S, 1e-3):
        known = [k for at_s, k in came_s if at_s <= now_s]
        if known:
            largest_s = max(largest_s, now_s - max(known) * STEP_S)
    found = peak_ages_s(np.array(sent)[:, None], ALL_IN, STEP_S)
    assert len(found) == len(came_s)
    if came_s:
        assert abs(found.max() - max(largest_s, found[-1])) < 2e-3
