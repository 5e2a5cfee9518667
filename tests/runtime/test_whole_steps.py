"""Test that steps are delivered whole, in order and once, in whatever order their messages arrive.

Subscribers are offered each step of a slow network, and a limited number of a fast one.
"""

import math
import random
from collections import defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.nodes.changes import Event, Gone, Joined
from concord.nodes.messages import Truth, decode, encode
from concord.runtime.drivers import in_memory
from concord.runtime.processes.recorder.throttled_feed import STEPS_PER_S, ThrottledFeed
from concord.runtime.whole_steps import WholeStep, WholeSteps
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare

NODES, STEPS, ROUNDS = 5, 24, 3
CHANGES = ("6 kill 2", "10 restart 2", "13 set rounds=1", "17 kill 4", "19 set rounds=20")
SETUP = prepare(
    definition_named("oscillator").defaults.with_(
        nodes=NODES, steps=STEPS, rounds=ROUNDS, changes=CHANGES
    )
)
MESSAGES = in_memory(SETUP)
Said = tuple[str, bytes]


def sources(messages: list[Said]) -> dict[str, list[tuple[int, Said]]]:
    """Return the messages of each process in order, with their steps.

    A share has the step of the next estimate.
    """
    said: dict[str, list[tuple[int, Said]]] = defaultdict(list)
    for topic, data in messages:
        kind, _, node = topic.partition("/")
        if kind in ("bid", "grant", "welcome"):
            continue
        source = node if kind in ("share", "estimate") else "environment"
        said[source].append((-1 if kind == "share" else decode(topic, data).step, (topic, data)))
    for mine in said.values():
        step = STEPS
        for place in reversed(range(len(mine))):
            step = step if mine[place][0] < 0 else mine[place][0]
            mine[place] = step, mine[place][1]
    return said


def steps_of(messages: list[Said]) -> list[WholeStep]:
    together = WholeSteps(NODES, ROUNDS, SHARE_FRAMES)
    return [step for message in messages for step in together.take(*message)]


@pytest.mark.parametrize("seed", range(20))
def test_processes_may_overtake_each_other(seed: int):
    said = sources(MESSAGES)
    expected: dict[int, set[Said]] = defaultdict(set)
    for mine in said.values():
        for step, message in mine:
            if message[0] != "event":
                expected[step].add(message)
    order = random.Random(seed)
    mixed: list[Said] = []
    while said:
        slowest = min(mine[0][0] for mine in said.values())
        heard = said["environment"][0][0] if "environment" in said else STEPS
        # The environment begins a step before the nodes; its message may still arrive after theirs.
        soon = min(slowest + 4, heard + 1)
        source = order.choice([name for name, mine in said.items() if mine[0][0] <= soon])
        mixed.append(said[source].pop(0)[1])
        if not said[source]:
            del said[source]
    steps = steps_of(mixed)
    assert [step.number for step in steps] == list(range(STEPS))
    for step in steps:
        assert len(step.messages) == len(expected[step.number])
        assert set(step.messages) == expected[step.number]


def test_a_step_is_given_with_the_last_word_of_those_who_are_in():
    together = WholeSteps(NODES, ROUNDS, SHARE_FRAMES)
    waiting: set[str] = set()
    for topic, data in MESSAGES:
        given_now = together.take(topic, data)
        if topic.startswith("measured/"):
            waiting.add(f"{topic.removeprefix('measured/')} {decode(topic, data).step}")
        elif topic.startswith("estimate/"):
            step = decode(topic, data).step
            waiting.discard(f"{topic.removeprefix('estimate/')} {step}")
            is_last = not any(one.endswith(f" {step}") for one in waiting)
            assert [one.number for one in given_now] == ([step] if is_last else [])


@pytest.mark.parametrize("late", ["environment", "2", "everybody but the environment"])
def test_a_link_that_is_far_behind_makes_no_hole(late: str):
    """A page showed all nodes as dead when the environment's link was quicker than theirs."""
    said = [(source, message) for source, mine in sources(MESSAGES).items() for _, message in mine]
    behind = [
        one
        for one in said
        if (one[0] == late) != (late.startswith("every") and one[0] != "environment")
    ]
    ahead = [one for one in said if one not in behind]
    expected = {step.number: set(step.messages) for step in steps_of(MESSAGES)}
    found = steps_of([message for _, message in ahead + behind])
    assert {step.number: set(step.messages) for step in found} == expected


@pytest.mark.parametrize("lost", ["estimate/1", "measured/3", "truth"])
def test_what_was_lost_on_its_way_holds_up_one_step_and_not_for_ever(lost: str):
    kept = [
        (topic, data)
        for topic, data in MESSAGES
        if topic != lost or decode(topic, data).step not in (7, 8)
    ]
    numbers = [step.number for step in steps_of(kept)]
    without = {7, 8} if lost == "truth" else set()
    assert numbers == [number for number in range(STEPS) if number not in without]


@pytest.mark.parametrize(
    "rubbish",
    [
        ("estimate/1", b"{"), ("estimate/77", b'{"step":3}'), ("estimate/x", b'{"step":3}'),
        ("estimate/1", b'{"step":1000000000}'), ("measured/1", b'{"step":-3}'), ("event", b"[]"),
        ("share/1", b""), ("share/1", b"\xff" * 60), ("unheard/of", b"x"), ("truth", b"[" * 9999),
    ],
)  # fmt: skip
def test_rubbish_holds_up_nothing(rubbish: Said):
    mixed = [one for message in MESSAGES for one in (rubbish, message)]
    assert [step.number for step in steps_of(mixed)] == list(range(STEPS))


def offered(times_s: list[float], at_once: int = 5) -> list[tuple[float, int]]:
    """When which step is offered, of steps that are over at these times, and asked for after."""
    offering, told = ThrottledFeed(at_once), []
    for number, now_s in enumerate(times_s):
        if (step := offering.take(WholeStep(number, []), now_s)) is not None:
            told.append((now_s, step.number))
    if offering.keeps_one:
        later_s = times_s[-1] + offering.rest_s(times_s[-1])
        step = offering.due(later_s + 1e-9)
        assert step is not None
        told.append((later_s, step.number))
    return told


GAPS = st.lists(st.floats(0, 0.5) | st.floats(0, 0.02), min_size=1, max_size=80)


@given(gaps=GAPS)
def test_no_more_steps_are_offered_than_an_eye_can_follow(gaps: list[float]):
    times_s = [sum(gaps[: number + 1]) for number in range(len(gaps))]
    told = offered(times_s)
    numbers = [number for _, number in told]
    assert numbers == sorted(set(numbers))
    for first, (begin_s, _) in enumerate(told):
        for last, (end_s, _) in enumerate(told[first:], first):
            most = 5 + math.floor(STEPS_PER_S * (end_s - begin_s) + 1e-6)
            assert last - first + 1 <= most
    # Wherever the network stands still, that is what is seen.
    assert numbers[-1] == len(gaps) - 1


# At exactly four intervals, rounding decides whether a step is within the burst.
@given(hurries=st.lists(st.floats(0, 3.999 / STEPS_PER_S), min_size=1, max_size=80))
def test_every_step_of_a_slow_network_is_offered(hurries: list[float]):
    beats = [number / STEPS_PER_S for number in range(len(hurries))]
    times_s: list[float] = []
    for beat, late in zip(beats, hurries, strict=True):
        times_s.append(max(beat + late, *times_s[-1:]) if times_s else beat + late)
    assert [number for _, number in offered(times_s)] == list(range(len(hurries)))


def test_a_slow_network_that_catches_up_after_a_stall_loses_no_step():
    beats_s = [number / STEPS_PER_S for number in range(700)]
    times_s = [beat_s if beat_s < 2 or beat_s > 30 else 30.0 for beat_s in beats_s]
    feed = ThrottledFeed()
    came = [feed.take(WholeStep(number, []), now_s) for number, now_s in enumerate(times_s)]
    assert [step.number for step in came if step is not None] == list(range(700))


def test_departures_that_are_over_are_forgotten():
    """In nineteen minutes of overload nodes left 5345 times. The recorder looked at all of these
    with every event, until it kept up no more."""
    together = WholeSteps(NODES, ROUNDS, SHARE_FRAMES, longest_wait_steps=8)
    for step in range(1000):
        node = step // 2 % NODES
        change = Joined(node) if step % 2 else Gone(node)
        together.take("event", encode(Event(step, change)))
        together.take("truth", encode(Truth(step, [0.0])))
    assert len(together._history.absent_steps) <= 2 * NODES
