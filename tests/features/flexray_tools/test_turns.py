"""Turns of nodes: the best ones against all that there are, and the places that they take."""

from collections import Counter
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.flexray_tools.slot_design import turns as module
from concord.features.flexray_tools.slot_design.demand import DemandError
from concord.features.flexray_tools.slot_design.turns import (
    CycleTurn,
    best_turns,
    equal_turns,
    places_of_turns,
)

TURNS = st.integers(0, 4).flatmap(
    lambda k: st.builds(CycleTurn, st.integers(0, (1 << k) - 1), st.just(1 << k))
)


@given(st.lists(TURNS, min_size=1, max_size=12))
def test_as_many_places_suffice_as_nodes_send_in_the_busiest_cycle(turns: list[CycleTurn]):
    places = places_of_turns(turns)
    sent = Counter(cycle for cycle in range(16) for turn in turns if turn.sends(cycle))
    assert max(places) + 1 == max(sent.values())
    for cycle in range(16):
        taken = [place for turn, place in zip(turns, places, strict=True) if turn.sends(cycle)]
        assert len(set(taken)) == len(taken)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), places=st.integers(1, 2))
def test_the_best_turns_are_those_of_all_that_there_are(seed: int, places: int):
    """A cost of each node by its longest silence, and of each pair that sends together."""
    draws = np.random.default_rng(seed)
    weights, together = draws.uniform(0.1, 3, 3), draws.uniform(0, 0.5, (3, 3))

    def cost(turns) -> float:
        alone = sum(w * turn.repetition for w, turn in zip(weights, turns, strict=True))
        pairs = sum(
            together[i, j] / 4
            for i, j in product(range(3), repeat=2)
            for cycle in range(4)
            if i < j and turns[i].sends(cycle) and turns[j].sends(cycle)
        )
        return float(alone + pairs)

    every = [CycleTurn(base, 1 << k) for k in range(3) for base in range(1 << k)]
    fitting = [
        turns
        for turns in product(every, repeat=3)
        if all(sum(turn.sends(cycle) for turn in turns) <= places for cycle in range(4))
    ]
    least = min(map(cost, fitting))
    found = best_turns(3, places, 4, cost)
    assert found.exact and found.cost == least == cost(found.turns)
    assert found.turns in fitting
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_MOST_TRIED", 0)
        near = best_turns(3, places, 4, cost)
    assert not near.exact and near.turns in fitting
    assert least <= near.cost <= cost(equal_turns(3, places, 4))


def test_turns_that_do_not_fit_are_refused():
    with pytest.raises(DemandError, match=r"9 nodes with at most 2 shares .* turns of 8 cycles"):
        best_turns(9, 2, 4, lambda _: 0.0)
