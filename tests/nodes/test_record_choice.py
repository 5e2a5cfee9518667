"""Sets of records, and which of them a node sends: the same from plain sets and fractions."""

from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_sets import (
    flags_of,
    newest_first,
    no_records,
    one_step_on,
    packed,
    with_record,
)

NODES, WINDOW, DIGEST = 10, 5, 3
Labels = frozenset[tuple[int, int]]
LABELS = st.frozensets(st.tuples(st.integers(0, WINDOW - 1), st.integers(0, NODES - 1)))
# Tellings and confirmations of records to one neighbour, in order.
EVENTS = st.lists(st.tuples(st.sampled_from(["told", "confirmed", "digest"]), LABELS), max_size=6)


def array_of(labels: Labels) -> NDArray[np.uint8]:
    sets = no_records((), WINDOW, NODES)
    for place, source in labels:
        sets = with_record(sets, place, source)
    return sets


def labels_of(sets: NDArray[np.uint8]) -> Labels:
    return frozenset(newest_first(sets, NODES))


class Ledger:
    """How often one neighbour was told of each record; None for one that it has confirmed."""

    def __init__(self) -> None:
        self.times: dict[tuple[int, int], int | None] = {}
        self.told = self.lacking = 0

    def say(self, what: str, labels: Labels) -> None:
        if what == "digest":
            for place in range(WINDOW - DIGEST, WINDOW):
                for source in range(NODES):
                    if self.times.get((place, source), 0) == 1:
                        self.told += 1
                        self.lacking += (place, source) not in labels
                    self.times[place, source] = None if (place, source) in labels else 0
        for label in labels if what != "digest" else ():
            before = self.times.get(label, 0)
            if what == "confirmed":
                self.times[label] = None
            elif before is not None:
                self.times[label] = min(before + 1, 2)

    def chance(self, label: tuple[int, int], loss: Fraction) -> Fraction:
        times = self.times.get(label, 0)
        if times is None or (times > 0 and label[0] < WINDOW - DIGEST):
            return Fraction(0)
        # Multiples of 1/1024, and never 0.
        return max(Fraction(1, 1024), Fraction(round(1024 * float(loss**times)), 1024))


def after(choice: RecordChoice, events: list[tuple[str, Labels]]):
    """The same in arrays, as (known (K, W, B), reports (2,)), and as a ledger."""
    ledger, known = Ledger(), no_records((choice.levels,), WINDOW, NODES)
    reports = np.zeros(2, dtype=np.int64)
    for what, labels in events:
        ledger.say(what, labels)
        if what == "digest":
            known, more = choice.reported(known, array_of(labels)[-DIGEST:])
            reports = reports + more
        else:
            known = getattr(choice, what)(known, array_of(labels))
    assert reports.tolist() == [ledger.told, ledger.lacking]
    return known, reports, ledger


@settings(max_examples=40)
@given(LABELS, st.lists(EVENTS, min_size=1, max_size=3), st.sampled_from([0.0, 0.5, 1.2]))
def test_a_node_sends_what_expectation_says(
    held: Labels, events: list[list[tuple[str, Labels]]], above: float
):
    choice = RecordChoice(NODES, WINDOW, DIGEST, above, repeat_bytes=10_000)
    all_known, reports, ledgers = zip(*(after(choice, some) for some in events), strict=True)
    total = np.sum(reports, axis=0)
    doubts = choice.doubts(array_of(held), np.stack(all_known))
    loss = Fraction(1 + int(total[1]), 4 + int(total[0]))
    chances = {label: [one.chance(label, loss) for one in ledgers] for label in held}
    urgency = {place: int(65536 * 0.9 ** (WINDOW - 1 - place) + 0.5) for place in range(WINDOW)}
    need = sum(some.count(1) * urgency[place] for (place, _), some in chances.items())
    assert choice.need(doubts) == need
    expected = {
        label for label, some in chances.items()
        if 1 in some or (sum(some) > 0 and sum(some) >= round(above * 1024) / Fraction(1024))
    }  # fmt: skip
    costs = np.full((WINDOW, NODES), 6)
    chosen, taken = choice.chosen(doubts, total, costs, np.array(10_000))
    assert labels_of(chosen) == expected
    assert taken == 6 * len(expected)


@settings(max_examples=40)
@given(LABELS, EVENTS, st.integers(0, 60), st.integers(0, 120))
def test_repetitions_stay_within_their_bytes(
    held: Labels, events: list[tuple[str, Labels]], cap: int, room: int
):
    choice = RecordChoice(NODES, WINDOW, DIGEST, 0.0, cap)
    known, reports, _ = after(choice, events)
    doubts = choice.doubts(array_of(held), known[None])
    costs = np.full((WINDOW, NODES), 6)
    new, _ = RecordChoice(NODES, WINDOW, DIGEST, 0.0, 0).chosen(
        doubts, reports, costs, np.array(room)
    )
    chosen, taken = choice.chosen(doubts, reports, costs, np.array(room))
    assert labels_of(new) <= labels_of(chosen) <= held
    assert taken == 6 * len(labels_of(chosen)) <= room
    assert len(labels_of(chosen) - labels_of(new)) <= cap // 6
    # The newest come first in either part.
    order = sorted(labels_of(array_of(held) & ~known[0]), key=lambda one: (-one[0], one[1]))
    assert labels_of(new) == frozenset(order[: room // 6])


@given(LABELS, LABELS)
def test_without_digests_a_record_that_was_told_is_known(held: Labels, told: Labels):
    choice = RecordChoice(NODES, WINDOW, 0)
    known = choice.told(no_records((2, 1), WINDOW, NODES), np.stack([array_of(told)] * 2))
    doubts = choice.doubts(array_of(held), known)
    chosen, _ = choice.chosen(
        doubts, np.zeros(2, dtype=np.int64), np.full((WINDOW, NODES), 6), np.array(10_000)
    )
    assert labels_of(chosen) == held - told
    assert (choice.need(doubts) == 0) == (held <= told)


@given(LABELS)
def test_sets_come_back_and_move_on(held: Labels):
    sets = array_of(held)
    ordered = sorted(held, key=lambda label: (-label[0], label[1]))
    assert list(newest_first(sets, NODES)) == ordered
    np.testing.assert_array_equal(packed(flags_of(sets, NODES)), sets)
    assert labels_of(one_step_on(sets)) == {(place - 1, s) for place, s in held if place}
