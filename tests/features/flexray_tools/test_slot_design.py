"""Slot design: every deadline met by an independent count, and no table with fewer slots."""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.presets import AUDI, DEMO
from concord.features.flexray_tools.response_times import ResponseTimes
from concord.features.flexray_tools.slot_design.demand import (
    Demand,
    DemandError,
    FrameDemand,
    ShareDemand,
    read_demand,
)
from concord.features.flexray_tools.slot_design.design import SlotDesign, design_slots
from concord.features.flexray_tools.slot_design.programme import Edition, Goal

pytestmark = pytest.mark.slow

SMALL = msgspec.structs.replace(
    DEMO,
    name="small",
    static_slots=3,
    static_payload_words=8,
    static_slot_macroticks=34,
    minislots=0,
    latest_transmission_minislot=0,
    network_idle_time_macroticks=1000 - 3 * 34,
    macroticks_per_cycle=1000,
    cycle_us=1000.0,
    microticks_per_cycle=40000,
    number_of_cycles=8,
)
"""Three static slots of 34 us at the beginning of cycles of 1 ms, counted to 8."""
FRAME_US = SMALL.action_point_us + SMALL.frame_us(16)


def end_us(cluster: Cluster, slot: MessageSlot, cycle: int) -> float:
    frame_us = cluster.frame_us(cluster.static_payload_bytes)
    begin_us = cycle * cluster.cycle_us + (slot.frame_id - 1) * cluster.static_slot_us
    return begin_us + cluster.action_point_us + frame_us


def response_us(cluster: Cluster, slot: MessageSlot, request_us: float) -> float:
    """Wait for the first slot that begins with a request or after it, cycle by cycle."""
    for cycle in itertools.count():
        begin_us = cycle * cluster.cycle_us + (slot.frame_id - 1) * cluster.static_slot_us
        if cycle % slot.repetition == slot.base_cycle and begin_us >= request_us - 1e-6:
            return end_us(cluster, slot, cycle) - request_us
    raise AssertionError


def check(cluster: Cluster, demand: Demand, designed: SlotDesign) -> None:
    """Count slots and responses anew; slots of a demand are found by their node."""
    for one, other in itertools.combinations(designed.slots, 2):
        if one.frame_id == other.frame_id and set(one.channel) & set(other.channel):
            both = math.gcd(one.repetition, other.repetition)
            assert (one.base_cycle - other.base_cycle) % both
    for frame in demand.frames:
        (slot,) = (slot for slot in designed.slots if slot.node == frame.node)
        assert slot.payload_bytes == frame.payload_bytes
        if frame.offset_us is None:
            (bound,) = ResponseTimes(cluster, [slot]).responses
            assert bound.worst_us is not None and bound.worst_us <= frame.deadline_us + 1e-6
            assert slot.repetition * cluster.cycle_us <= frame.period_us + 1e-6
            continue
        responses = [
            response_us(cluster, slot, frame.offset_us + request * frame.period_us)
            for request in range(16)
        ]
        assert max(responses) <= frame.deadline_us + 1e-5
        # Bound and random traffic know the request times as well.
        (bound,) = ResponseTimes(cluster, [slot]).responses
        assert bound.worst_us == pytest.approx(max(responses), abs=1e-4)
    for share in demand.shares:
        slots = [slot for slot in designed.slots if slot.node == share.node]
        assert len({(slot.base_cycle, slot.repetition) for slot in slots}) == 1
        first, last = min(s.frame_id for s in slots), max(s.frame_id for s in slots)
        span_us = (last - first) * cluster.static_slot_us
        frame_us = cluster.action_point_us + cluster.frame_us(cluster.static_payload_bytes)
        assert slots[0].repetition * cluster.cycle_us + span_us + frame_us <= share.age_us + 1e-6
        assert sum(slot.payload_bytes for slot in slots) >= share.share_bytes
    assert designed.used_slots == len({slot.frame_id for slot in designed.slots})


def fewest(cluster: Cluster, demand: Demand, edition: Edition) -> float:
    """Return the fewest slots over every slot, base and repetition of every frame; inf for none."""
    options: list[list[MessageSlot]] = []
    for frame in demand.frames:
        found: list[MessageSlot] = []
        for frame_id in range(1, cluster.static_slots + 1):
            for repetition in (1, 2, 4, 8):
                for base in range(repetition):
                    slot = MessageSlot(
                        frame_id=frame_id, payload_bytes=0, base_cycle=base, repetition=repetition
                    )
                    if frame.offset_us is None:
                        late = repetition * cluster.cycle_us + FRAME_US > frame.deadline_us + 1e-6
                        late |= repetition * cluster.cycle_us > frame.period_us
                    else:
                        late = repetition * cluster.cycle_us > frame.period_us or any(
                            response_us(cluster, slot, frame.offset_us + k * frame.period_us)
                            > frame.deadline_us + 1e-6
                            for k in range(4)
                        )
                    if not late:
                        found.append(slot)
        options.append(found)
    nodes = [frame.node for frame in demand.frames]
    best = math.inf
    for ways in itertools.product(*options):
        clash = any(
            one.frame_id == other.frame_id and (apart or _in_one_cycle(one, other))
            for (one, first), (other, second) in itertools.combinations(
                zip(ways, nodes, strict=True), 2
            )
            for apart in (edition == "2.1" and first != second,)
        )
        if not clash:
            best = min(best, len({slot.frame_id for slot in ways}))
    return best


def _in_one_cycle(one: MessageSlot, other: MessageSlot) -> bool:
    shorter = math.gcd(one.repetition, other.repetition)
    return (one.base_cycle - other.base_cycle) % shorter == 0


@st.composite
def demands(draw: st.DrawFn, most: int = 3) -> Demand:
    frames: list[FrameDemand] = []
    for node in range(draw(st.integers(1, most))):
        cycles = draw(st.sampled_from([1, 2, 4, 8]))
        known = draw(st.booleans())
        frames.append(
            FrameDemand(
                node=node,
                payload_bytes=2 * draw(st.integers(0, 8)),
                period_us=1000.0 * cycles,
                deadline_us=draw(st.integers(1, 40)) * 250.0 + FRAME_US,
                offset_us=draw(st.integers(0, 80)) * 17.0 if known else None,
            )
        )
    return Demand(tuple(frames))


@settings(max_examples=60, deadline=None)
@given(demands(), st.sampled_from(["2.1", "3.0.1"]), st.booleans())
def test_no_table_has_fewer_slots_and_each_frame_is_in_time(
    demand: Demand, edition: Edition, paired: bool
):
    best = fewest(SMALL, _paired(demand) if paired else demand, edition)
    try:
        wanted = _paired(demand) if paired else demand
        designed = design_slots(wanted, SMALL, "slots", edition)
    except DemandError as refused:
        assert best == math.inf, refused
        assert "\n" not in str(refused)
        return
    if not paired:
        check(SMALL, demand, designed)
    assert designed.exact and designed.used_slots == best
    if edition == "2.1":
        owners = {(slot.frame_id, slot.node) for slot in designed.slots}
        assert len(owners) == designed.used_slots


def _paired(demand: Demand) -> Demand:
    """Let two frames belong to one node, so that they may share a slot in FlexRay 2.1."""
    frames = (msgspec.structs.replace(one, node=one.node // 2) for one in demand.frames)
    return Demand(tuple(frames))


def test_turns_fill_slots_exactly():
    """Periods of 1, 2, 4, 4, 8 and 8 cycles are 1 + 1/2 + 1/2 + 1/4 slots."""
    periods = [1, 2, 4, 4, 8, 8]
    frames = [
        FrameDemand(node=i, payload_bytes=2, period_us=1000.0 * n, deadline_us=1e5)
        for i, n in enumerate(periods)
    ]
    designed = design_slots(Demand(tuple(frames)), SMALL)
    check(SMALL, Demand(tuple(frames)), designed)
    assert designed.used_slots == math.ceil(sum(1 / n for n in periods)) == 3


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_large_bus_is_full_to_its_load(seed: int):
    """Frames without offsets need the ceiling of their load, whatever they are."""
    random = np.random.default_rng(seed)
    cycles = 2 ** random.integers(0, 7, 120)
    frames = [
        FrameDemand(node=i, payload_bytes=34, period_us=5000.0 * n, deadline_us=5000.0 * n + 100)
        for i, n in enumerate(cycles.tolist())
    ]
    demand = Demand(tuple(frames))
    load = float((1 / cycles).sum())
    try:
        designed = design_slots(demand, AUDI)
    except DemandError:
        assert load > AUDI.static_slots
        return
    check(AUDI, demand, designed)
    assert designed.used_slots == math.ceil(load - 1e-9)


@settings(max_examples=3, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["slots", "error"]),
    st.sampled_from(["2.1", "3.0.1"]),
)
def test_a_mixed_bus_on_two_channels_is_in_time(seed: int, goal: Goal, edition: Edition):
    random = np.random.default_rng(seed)
    car = msgspec.structs.replace(AUDI, channels="AB")
    channels: list[Any] = ["A", "B", "AB", "any"]
    frames = [
        FrameDemand(
            node=node,
            payload_bytes=2 * int(random.integers(0, 18)),
            period_us=5000.0 * 2 ** int(random.integers(0, 4)),
            deadline_us=float(random.uniform(5100, 40_000)),
            offset_us=float(random.uniform(0, 10_000)) if random.random() < 0.5 else None,
            channel=channels[random.integers(4)],
        )
        for node in range(30)
    ]
    shares = [
        ShareDemand(node=30 + k, share_bytes=int(random.integers(1, 90)),
                    age_us=float(random.uniform(9000, 60_000)),
                    channel=channels[random.integers(4)])
        for k in range(8)
    ]  # fmt: skip
    demand = Demand(tuple(frames), tuple(shares))
    designed = design_slots(demand, car, goal, edition)
    check(car, demand, designed)


def test_two_channels_carry_twice_as_much():
    both = msgspec.structs.replace(SMALL, channels="AB")
    frames = tuple(
        FrameDemand(node=i, payload_bytes=2, period_us=1000.0, deadline_us=2000.0) for i in range(6)
    )
    with pytest.raises(DemandError, match=r"need 6 static slots .*has 3"):
        design_slots(Demand(frames), SMALL)
    designed = design_slots(Demand(frames), both)
    check(both, Demand(frames), designed)
    assert designed.used_slots == 3
    assert sorted(slot.channel for slot in designed.slots) == ["A"] * 3 + ["B"] * 3
    doubled = tuple(msgspec.structs.replace(one, channel="AB") for one in frames[:2])
    mixed = Demand((*doubled, *frames[2:4]))
    designed = design_slots(mixed, both)
    check(both, mixed, designed)
    assert designed.used_slots == 3


def test_a_share_of_several_frames_goes_in_one_cycle():
    # 2 x 8 bytes of payload carry 8 bytes of a share each, beside their numbers.
    shares = tuple(ShareDemand(node=i, share_bytes=20, age_us=2200.0) for i in range(2))
    designed = design_slots(Demand((), shares), SMALL)
    check(SMALL, Demand((), shares), designed)
    assert len(designed.slots) == 6 and designed.used_slots == 3
    assert designed.error == pytest.approx(2 * (2000 + 2 * 34 + FRAME_US))


def test_the_error_goes_before_slots_where_it_is_asked_for():
    shares = tuple(
        ShareDemand(node=i, share_bytes=4, age_us=1e5, growth=growth)
        for i, growth in enumerate((5.0, 1.0, 1.0, 1.0, 1.0))
    )
    demand = Demand((), shares)
    few = design_slots(demand, SMALL)
    best = design_slots(demand, SMALL, "error")
    check(SMALL, demand, few)
    check(SMALL, demand, best)
    assert few.used_slots == 1 and best.used_slots == 3
    # The best of all ways to give repetitions whose load fits three slots.
    least = min(
        sum(one.growth * (r * 1000 + FRAME_US) for one, r in zip(shares, ways, strict=True))
        for ways in itertools.product((1, 2, 4, 8), repeat=5)
        if sum(1 / r for r in ways) <= 3
    )
    assert best.error == pytest.approx(least) and best.error < few.error
    (fast,) = (slot for slot in best.slots if slot.node == 0)
    assert fast.repetition == 1


FRAME: dict[str, Any] = {"node": 1, "payload_bytes": 8, "period_us": 4000.0, "deadline_us": 5000.0}
SHARE: dict[str, Any] = {"node": 2, "share_bytes": 4, "age_us": 2000.0}


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        (
            FRAME,
            {"deadline_us": 900.0},
            r"within 900 us, but .* cycle of 1000 us .* allow 1028.2 us",
        ),
        (FRAME, {"period_us": 900.0}, "period_us is 900, but a slot comes once in a cycle"),
        (FRAME, {"payload_bytes": 18}, "payload_bytes is 18, .* 0 to 16"),
        (FRAME, {"deadline_us": math.nan}, "deadline_us is nan; use a positive number"),
        (FRAME, {"offset_us": 10.0, "period_us": 3000.0}, "1, 2, 4, 8 cycles .* but is 3"),
        (FRAME, {"offset_us": 500.0, "deadline_us": 400.0}, r"no static slot ends within 400 us"),
        (FRAME, {"channel": "B"}, "channel is B, but cluster 'small' has A"),
        (FRAME, {"node": -1}, "numbered from 0"),
        (SHARE, {"age_us": 1000.0}, r"share 1 of node 2: it must arrive within 1000 us"),
        (SHARE, {"share_bytes": 0}, "share_bytes is 0"),
        (SHARE, {"share_bytes": 900}, r"takes \d+ slots in a cycle, but cluster 'small' has 3"),
    ],
)
def test_demands_that_cannot_be_met_are_one_sentence(kind, changes, said: str):
    values = {**kind, **changes}
    frames = (FrameDemand(**values),) if kind is FRAME else ()
    shares = (ShareDemand(**values),) if kind is SHARE else ()
    with pytest.raises(DemandError, match=said) as refused:
        design_slots(Demand(frames, shares), SMALL)
    assert "\n" not in str(refused.value)


def frame_list(count: int) -> Sequence[FrameDemand]:
    return [
        FrameDemand(node=i, payload_bytes=2, period_us=8000.0, deadline_us=100.0, offset_us=20.0)
        for i in range(count)
    ]


def test_frames_of_one_moment_need_slots_beside_each_other():
    """Requests at 20 us are late in slot 1 and miss 100 us in slot 4; two slots are left."""
    designed = design_slots(Demand(tuple(frame_list(2))), SMALL)
    check(SMALL, Demand(tuple(frame_list(2))), designed)
    assert {slot.frame_id for slot in designed.slots} == {2, 3}
    with pytest.raises(DemandError, match=r"need 3 static slots .*3 of slots 2 to 3"):
        design_slots(Demand(tuple(frame_list(3))), SMALL)


def test_tables_are_read_and_mistakes_named(tmp_path: Path):
    path = tmp_path / "frames.toml"
    path.write_text(
        "[[frames]]\nnode = 1\npayload_bytes = 8\nperiod_us = 4000.0\ndeadline_us = 5000.0\n"
        "[[shares]]\nnode = 2\nshare_bytes = 4\nage_us = 2000.0\n"
    )
    assert read_demand(path) == Demand((FrameDemand(**FRAME),), (ShareDemand(**SHARE),))
    with pytest.raises(DemandError, match="asks for nothing"):
        design_slots(Demand(), SMALL)
    for text, said in (("frames = ", "is no table"), ("[[frames]]\nnode = 1\n", "payload_bytes")):
        path.write_text(text)
        with pytest.raises(DemandError, match=said):
            read_demand(path)
    with pytest.raises(DemandError, match="No such file"):
        read_demand(tmp_path / "none.toml")
