"""Seeds chosen by the states that they reach, which are those of the machines."""

import random
from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import combinations

import msgspec
import pytest

from concord.nodes.changes import Welcome
from concord.nodes.messages import NodeEvent
from concord.nodes.node_state import NodeConfig, NodeState, Phase
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import complete_settings, prepare
from concord.scenarios.script import script_of
from tests.experiments.command_support import Said
from tests.laboratory.case import draw_case
from tests.laboratory.coverage import State, covering, states_of, words_of

pytestmark = pytest.mark.slow


@cache
def drawn(seed: int) -> frozenset[State]:
    return states_of(draw_case(seed, {}))


def reached(seeds: Sequence[int]) -> int:
    return len(frozenset[State]().union(*(drawn(seed) for seed in seeds)))


def test_chosen_seeds_reach_more_than_as_many_others():
    """Twelve of sixty, against the first twelve and a hundred drawings of twelve."""
    seeds, drawing = range(1, 61), random.Random(1)
    chosen = covering(seeds, 12, drawn)
    assert len({*chosen}) == 12 and chosen == sorted(chosen)
    blind = [reached(drawing.sample(seeds, 12)) for _ in range(100)]
    assert reached(chosen) > max(*blind, reached(seeds[:12]))
    assert covering([5, 7], 9, drawn) == [5, 7]


def test_states_are_those_of_the_machines():
    """The words that stand as nodes have them, in each phase; a death stands from its step on."""
    lines = ("2 kill 1", "3 restart 1", "3 hang 2 2", "5 corrupt 0.1", "6 cut 0 1", "7 calm")
    fixed = {"changes": lines, "wire": (), "nodes": 4, "steps": 9, "schedule": "dynamic"}
    fixed |= {"scenario": "oscillator", "occupancy": 0.5, "rule": "ci", "graph": "ring"}
    case = draw_case(3, {**fixed, "loss": 0.0, "links": "static", "cluster": "fitted"})
    setup, seen = prepare(case.scenario), set[State]()

    def watch(config: NodeConfig, _: NodeEvent | Welcome, state: NodeState) -> None:
        if state.phase in (Phase.GRANT, Phase.SHARES):
            words = sorted(words_of(config.standing, state.step))
            together = [*((word,) for word in words), *combinations(words, 2)]
            seen.update((state.phase, several) for several in together)

    in_process.run(
        build_environment(setup),
        [build_node(setup, node) for node in range(4)],
        MemoryRecorder(),
        watch=watch,
        script=script_of(case.scenario),
        check=partial(complete_settings, setup),
    )
    said = states_of(case)
    assert {phase for phase, _ in said} == {*Phase} - {Phase.FINISHED}
    assert seen == {one for one in said if one[0] in (Phase.GRANT, Phase.SHARES)}
    assert {("kill",), ("hang",), ("corrupt", "cut")} < {words for _, words in seen}


def test_most_runs_the_chosen_seeds_and_says_what_they_reach(laboratory: Callable[..., Said]):
    words = ("--seeds", "1..6", "--most", "2", "--workers", "1", "--json")
    code, out, err = laboratory("drawn", *words)
    result = msgspec.json.decode(out)
    assert (code, result["cases"]) == (0, 2)
    chosen = covering(range(1, 7), 2, drawn)
    assert result["seeds"] == chosen
    counts = reached(chosen), reached(range(1, 7)), reached([1, 2])
    assert "2 of 6 seeds reach {} of {} states; the first 2 reach {}\n".format(*counts) in err
    code, out, err = laboratory("drawn", "--seeds", "1..6", "--most", "0")
    assert (code, out) == (2, "") and "--most 0: must be at least 1" in err
