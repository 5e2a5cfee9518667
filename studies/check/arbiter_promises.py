"""Promises of an arbiter: a function of urgency, or an `Arbiter`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.bus.arbitration import NO_BID, Arbiter, ArbiterState, award, begin_arbitration
from concord.scenarios.bus_table.bus_plan import arbiter_named
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.studies.check.promise import Promise, PromiseResult, fault_of, raised
from concord.studies.check.rule_promises import AGREEMENT

_RUNS, _MOST_CONTENDERS, _LARGEST_BID = 4, 8, 1000
_ASKS = 0.7
# Contests in which all nodes ask alike; an arbiter that is fair serves each of them often.
_CONTESTS = 40


class CheckedArbiter(NamedTuple):
    """An arbiter that is checked, and a small network with it."""

    arbiter: Arbiter
    scenario: Scenario


class Contest(NamedTuple):
    """A contest of C nodes in R runs: bids (R, C), frame IDs (C,), slots, and the memory."""

    state: ArbiterState
    bids: np.ndarray
    frame_ids: np.ndarray
    slots: int

    def wins(self, arbiter: Arbiter) -> np.ndarray:
        """The winners (R, C)."""
        nodes = np.arange(self.bids.shape[-1])
        return award(arbiter, self.state, nodes, self.frame_ids, self.bids, self.slots)[1]


def checked_arbiter(name: str) -> CheckedArbiter:
    """Return an arbiter by its name or its place in a file.

    Raises:
        ValueError: there is no such arbiter.
    """
    scenario = scenario_of(
        "oscillator", schedule="dynamic", occupancy=0.4, arbiter=name, nodes=5, steps=12
    )
    prepare(scenario)
    return CheckedArbiter(arbiter_named(name), scenario)


def draw_contest(number: int) -> Contest:
    """Return the contest of a number."""
    generator = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(0xA2B,)))
    contenders = int(generator.integers(2, _MOST_CONTENDERS + 1))
    shape = (_RUNS, contenders)
    bids = generator.integers(0, _LARGEST_BID, shape)
    bids = np.where(generator.random(shape) < _ASKS, bids, NO_BID)
    frame_ids = 1 + np.sort(generator.permutation(3 * contenders)[:contenders])
    last = np.append(frame_ids, 0)[generator.integers(0, contenders + 1, _RUNS)]
    state = ArbiterState(last, generator.integers(0, 5, shape))
    return Contest(state, bids, frame_ids, int(generator.integers(1, contenders + 1)))


def _slots_go_to_those_who_ask(arbiter: Arbiter, contest: Contest) -> str:
    wins, asks = contest.wins(arbiter), contest.bids != NO_BID
    if (wins & ~asks).any():
        return "a node wins that did not ask"
    due = np.minimum(asks.sum(axis=-1), contest.slots)
    if (wins.sum(axis=-1) != due).any():
        return f"{wins.sum(axis=-1).tolist()} nodes win in the runs, where {due.tolist()} could"
    return ""


def _each_run_has_its_own_result(arbiter: Arbiter, contest: Contest) -> str:
    wins = contest.wins(arbiter)
    for run in range(_RUNS):
        state = ArbiterState(contest.state.last_frame_id[run], contest.state.waits[run])
        alone = contest._replace(state=state, bids=contest.bids[run]).wins(arbiter)
        if not np.array_equal(alone, wins[run]):
            return f"run {run} of {_RUNS} has other winners than the same run alone"
    return ""


def _order_of_contenders_does_not_matter(arbiter: Arbiter, contest: Contest) -> str:
    usual = contest.wins(arbiter)
    back = np.arange(usual.shape[-1])[::-1]
    state = ArbiterState(contest.state.last_frame_id, contest.state.waits[:, back])
    turned = contest._replace(
        state=state, bids=contest.bids[:, back], frame_ids=contest.frame_ids[back]
    )
    same = np.array_equal(turned.wins(arbiter)[:, back], usual)
    return "" if same else "contenders in reverse order have other winners"


def _nothing_is_remembered(arbiter: Arbiter, contest: Contest) -> str:
    untouched, again = _copied(contest), _copied(contest)
    first = contest.wins(arbiter)
    draw_contest(0).wins(arbiter)
    if not np.array_equal(first, again.wins(arbiter)):
        return "equal contests have other winners the second time"
    kept, before = ((*one.state, one.bids, one.frame_ids) for one in (contest, untouched))
    same = all(np.array_equal(one, other) for one, other in zip(kept, before, strict=True))
    return "" if same else "the arbiter changes the numbers that it is given"


def _copied(contest: Contest) -> Contest:
    state = ArbiterState(*(np.copy(part) for part in contest.state))
    return Contest(state, contest.bids.copy(), contest.frame_ids.copy(), contest.slots)


def _check(
    seen: Callable[[Arbiter, Contest], str], checked: CheckedArbiter, cases: Sequence[int]
) -> PromiseResult:
    for number in cases:
        contest = draw_contest(number)
        if found := fault_of(partial(seen, checked.arbiter, contest)):
            size = f"contenders {contest.bids.shape[-1]}, slots {contest.slots}"
            return PromiseResult("BROKEN", f"case {number}, {size}: {found}", number)
    return PromiseResult("holds", f"{len(cases)} contests of {_RUNS} runs")


def _serves_all(checked: CheckedArbiter, cases: Sequence[int]) -> PromiseResult:
    if checked.arbiter.by_class:
        return PromiseResult("skipped", "urgency classes bound the wait, whatever nodes bid")
    nodes = np.arange(checked.scenario.nodes)
    state, served = begin_arbitration(len(nodes)), np.zeros(len(nodes), dtype=int)
    for _ in range(_CONTESTS):
        try:
            state, wins = award(checked.arbiter, state, nodes, 1 + nodes, np.ones_like(nodes), 1)
        except Exception as error:  # a user's function may raise anything
            return PromiseResult("BROKEN", raised(error))
        served += wins
    if (served > 0).all():
        return PromiseResult("holds", f"wins of {_CONTESTS} equal contests: {served.tolist()}")
    never = np.flatnonzero(served == 0).tolist()
    return PromiseResult("note", f"nodes {never} never win {_CONTESTS} contests in which all bid 1")


ARBITER_PROMISES: tuple[Promise[CheckedArbiter], ...] = (
    Promise("slots", "slots go to those who ask", partial(_check, _slots_go_to_those_who_ask)),
    Promise("lanes", "each run has its own result", partial(_check, _each_run_has_its_own_result)),
    Promise(
        "order",
        "the order of contenders does not matter",
        partial(_check, _order_of_contenders_does_not_matter),
    ),
    Promise("memory", "equal contests have equal winners", partial(_check, _nothing_is_remembered)),
    Promise("starvation", "who asks is served some time", _serves_all),
    AGREEMENT,
)
