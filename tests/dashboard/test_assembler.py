"""Messages into frames: against the arrays that `concord collect` makes of the same messages."""

import random
from collections.abc import Iterable
from functools import cache

import msgspec
import numpy as np
import pytest

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.network import NetworkStatus
from concord.nodes.messages import Estimate, decode
from concord.results.records.trace import Trace, read_trace
from concord.runtime.whole_steps import WholeStep, WholeSteps
from tests.dashboard.runs import event, frames_of, run_of
from tests.experiments.support import summary_of

RUN = run_of("target-tracking", nodes=8, steps=24, schedule="hybrid", occupancy=0.5)


@cache
def trace() -> Trace:
    """The arrays of the run."""
    return read_trace(RUN.stage.setup, RUN.messages)


def step_of(topic: str, data: bytes) -> int | None:
    return None if topic.startswith("share/") else getattr(decode(topic, data), "step", None)


def without(node: int, since: int):
    """The same run in which a node falls silent."""
    for topic, data in RUN.messages:
        hers = topic in (f"estimate/{node}", f"measured/{node}")
        if not (hers and (step_of(topic, data) or 0) >= since):
            yield topic, data


def test_every_step_is_a_frame_with_the_beliefs_of_the_trace():
    assert [frame.step for frame in RUN.frames] == list(range(24))
    for frame in RUN.frames:
        np.testing.assert_array_equal(frame.belief.mean, trace().mean[frame.step])
        np.testing.assert_array_equal(frame.belief.cov, trace().cov[frame.step])
        np.testing.assert_array_equal(frame.truth, trace().truth[frame.step])


def test_who_published_in_which_cycle_is_that_of_the_trace():
    for frame in RUN.frames:
        for number, cycle in enumerate(frame.cycles):
            assert cycle.cycle == 3 * frame.step + number
            senders = {one.node for one in cycle.frames}
            assert senders == set(np.flatnonzero(trace().published[frame.step, number]))
            assert cycle.payload_bytes == trace().payload_bytes[frame.step, number].sum()


def test_scores_are_the_figures_of_the_run():
    figures = summary_of(RUN.stage.setup, trace())
    scored = RUN.frames[figures.first_step :]
    rmse = np.sqrt(np.mean([frame.scores.error**2 for frame in scored]))
    central = np.sqrt(np.mean([frame.scores.central**2 for frame in scored]))
    nees = np.mean([frame.scores.nees for frame in scored]) / len(RUN.stage.score.nees_states)
    assert rmse == pytest.approx(figures.value("rmse"))
    assert central == pytest.approx(figures.value("rmse_centralised"))
    assert nees == pytest.approx(figures.value("anees"))


def test_nothing_is_lost_in_a_run_that_loses_nothing():
    assert not any(frame.lost.any() for frame in RUN.frames)
    assert all(frame.alive.all() for frame in RUN.frames)


def test_messages_of_a_step_may_come_in_any_order():
    """A share belongs to the step that its sender estimates next."""
    order = random.Random(3)
    by_step: dict[int, list] = {}
    under_way: dict[str, int] = {}
    latest = 0
    for topic, data in RUN.messages:
        kind, _, name = topic.partition("/")
        step = step_of(topic, data)
        if kind == "share":
            step = under_way.get(name, 0)
        elif kind == "estimate" and step is not None:
            under_way[name] = step + 1
        latest = max(latest, step or 0)
        by_step.setdefault(latest if step is None else step, []).append((topic, data))
    shuffled = []
    for _, part in sorted(by_step.items()):
        estimates = [m for m in part if m[0].startswith("estimate/")]
        rest = [m for m in part if not m[0].startswith("estimate/")]
        order.shuffle(rest)
        order.shuffle(estimates)
        shuffled += rest + estimates
    again = frames_of(RUN.stage, shuffled)
    assert [frame.step for frame in again] == [frame.step for frame in RUN.frames]
    for one, other in zip(again, RUN.frames, strict=True):
        np.testing.assert_array_equal(one.belief.mean, other.belief.mean)
        assert one.scores.central == other.scores.central


def test_a_node_that_dies_unannounced_is_down_and_its_last_belief_stays():
    frames = frames_of(RUN.stage, list(without(2, 9)))
    assert [frame.alive[2] for frame in frames[:9]] == [True] * 9
    down = [frame for frame in frames if frame.step >= 9]
    assert down
    assert not any(frame.alive[2] for frame in down)
    np.testing.assert_array_equal(down[-1].belief.mean[2], trace().mean[8, 2])
    told = [e for frame in frames for e in frame.events if e.node == 2]
    assert [(e.step, e.trouble) for e in told] == [(9, True)]


def test_a_node_that_left_is_not_waited_for():
    messages = list(without(2, 9))
    first_estimate = next(
        i for i, m in enumerate(messages) if m[0].startswith("estimate/") and step_of(*m) == 9
    )
    messages.insert(first_estimate, event(9, what="left", node=2))
    frames = frames_of(RUN.stage, messages)
    assert [frame.step for frame in frames] == list(range(24))
    assert not frames[9].alive[2]
    assert [e.text for e in frames[9].events] == ["node 02 was killed"]


def test_a_cut_link_holds_from_its_step_until_it_is_healed():
    i, j = map(int, RUN.stage.edges[0])
    told = [
        event(5, what="cut", sender=i, receiver=j),
        event(11, what="healed", sender=i, receiver=j),
    ]
    frames = frames_of(RUN.stage, told + RUN.messages)
    assert [frame.step for frame in frames if frame.cut[0]] == list(range(5, 11))
    assert not any(frame.cut[1:].any() for frame in frames)


def test_a_share_that_did_not_arrive_is_lost_at_its_receiver():
    receiver, sender = map(int, RUN.stage.heard[0])
    place = RUN.stage.setup.neighbours[receiver].index(sender)
    messages = []
    for topic, data in RUN.messages:
        message = None if topic.startswith("share/") else decode(topic, data)
        if isinstance(message, Estimate) and (message.node, message.step) == (receiver, 10):
            message.ages[place] += 4
            data = msgspec.json.encode(message)
        messages.append((topic, data))
    lost = {
        (frame.step, int(k))
        for frame in frames_of(RUN.stage, messages)
        for k in np.flatnonzero(frame.lost)
    }
    assert lost == {(10, 0)}


def steps_of() -> list[WholeStep]:
    together = WholeSteps(8, 3, SHARE_FRAMES)
    return [step for message in RUN.messages for step in together.take(*message)]


def shown(assembler: Assembler, steps: Iterable[WholeStep]) -> list[StepFrame]:
    frames = [assembler.frame(step) for step in steps]
    return [frame for frame in frames if frame is not None]


@pytest.mark.parametrize("chosen", [range(12, 24), (1, 2, 9, 10, 20), (0, 23)])
def test_frames_of_some_steps_are_those_of_all(chosen):
    steps = steps_of()
    frames = shown(Assembler(RUN.stage), [steps[number] for number in chosen])
    assert [frame.step for frame in frames] == list(chosen)
    for frame in frames:
        whole = RUN.frames[frame.step]
        np.testing.assert_array_equal(frame.belief.mean, whole.belief.mean)
        np.testing.assert_array_equal(frame.ages, whole.ages)
        assert frame.cycles == whole.cycles
        assert all(map(np.array_equal, frame.traffic, whole.traffic))
        # The page claims no loss for nodes that may have sent meanwhile.
        assert not frame.lost.any()
    followed = {frame.step for frame in frames if not np.isnan(frame.scores.central)}
    # The filter that hears everything must not miss a step, not even the first.
    assert followed == {step for place, step in enumerate(chosen) if step == place}


def test_a_step_that_comes_again_or_too_late_is_not_drawn_twice():
    steps = steps_of()
    order = [steps[number] for number in (3, 4, 4, 2, 5)]
    assert [frame.step for frame in shown(Assembler(RUN.stage), order)] == [3, 4, 5]


def test_cycles_count_from_where_the_network_says():
    later = NetworkStatus(frozenset(range(8)), (4, 12, 3))
    frames = shown(Assembler(RUN.stage, later), steps_of())
    numbers = [[cycle.cycle for cycle in frame.cycles] for frame in frames]
    assert numbers == [[cycle.cycle for cycle in frame.cycles] for frame in RUN.frames]


@pytest.mark.parametrize(
    "rubbish",
    [
        ("share/1", b"\0" * 30), ("share/99", b""), ("estimate/1", b"{"), ("event", b"[]"),
        ("event", b'{"step":1,"change":{"what":"gone","node":77}}'),
        ("event", b'{"step":1,"change":{"what":"from the future"}}'), ("unheard/of", b"x"),
    ],
)  # fmt: skip
def test_rubbish_changes_nothing(rubbish: tuple[str, bytes]):
    frames = frames_of(RUN.stage, [rubbish, *RUN.messages])
    assert [frame.scores.rmse for frame in frames] == [frame.scores.rmse for frame in RUN.frames]


@pytest.mark.parametrize(
    ("name", "changes"),
    [("meng2025", {}), ("vehicle-network", {}), ("liu2021-network", {}), ("oscillator", {})],
)
def test_every_kind_of_scenario_makes_frames(name: str, changes: dict):
    run = run_of(name, steps=6, **changes)
    assert [frame.step for frame in run.frames] == list(range(6))
