"""Test urgency classes: frame IDs by class, FlexRay's own arbitration, and no starvation."""

from math import floor, log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, NO_BID, ONE_CLASS, UrgencyClasses, begin_arbitration
from concord.bus.bus import Rejected
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.flexray_bus import FlexRayBus, flexray_bus
from concord.bus.flexray.presets import AUDI, DEMO
from concord.bus.flexray.share_frames import payload_lengths, read_frame
from concord.bus.schedule import Schedule, dynamic_only
from tests.bus.support import quick

LEAST, MOST = 16, 16 * 2**10


def bus_of(
    nodes: int, count: int, slots: int, cluster: Cluster | None = None, share_bytes: int = 60
) -> FlexRayBus:
    """A bus on which all nodes contend for `slots` shares of a cycle with so many classes each."""
    schedule = dynamic_only(nodes, slots / nodes)
    if cluster is None:
        cluster = fitted_cluster(schedule, payload_lengths(share_bytes), count)
    classes = UrgencyClasses(count, LEAST, MOST, old_after=nodes)
    return flexray_bus(schedule, cluster, share_bytes, ARBITERS["urgency"], classes=classes)


def unasked() -> np.ndarray:
    """Lengths of shares on a bus that holds all that may win: nothing depends on them."""
    raise AssertionError("all shares fit")


def by_slots(
    bus: FlexRayBus, bids: list[int], waits: list[int], sizes: list[int], most: int
) -> list[int]:
    """The senders of a cycle in order, slot by slot of FlexRay's slot counter."""
    cluster, nodes, count = bus.cluster, len(bids), bus.classes.count
    owner = {slot.frame_id: slot.node for slot in bus.table.assignments}
    buffers: dict[int, int] = {}
    for node, (bid, wait) in enumerate(zip(bids, waits, strict=True)):
        if bid == NO_BID:
            continue
        step = log(MOST / LEAST) / max(1, count - 1)
        level = floor(log(max(bid, LEAST) / LEAST) / step + 1e-9)
        own = 0 if wait >= nodes else count - 1 - min(max(level, 0), max(count - 2, 0))
        mine = [frame_id for frame_id, of in sorted(owner.items()) if of == node]
        buffers[mine[own]] = node
    senders: list[int] = []
    slot, minislot = cluster.first_dynamic_id, 1
    while minislot <= cluster.minislots:
        node = buffers.get(slot)
        length = 1
        if node is not None and len(senders) < most:
            needed = cluster.dynamic_slot_minislots(sizes[node])
            late = minislot > cluster.latest_transmission_minislot
            if not late and minislot + needed - 1 <= cluster.minislots:
                senders.append(node)
                length = needed
        slot, minislot = slot + 1, minislot + length
    return senders


@quick
@given(
    st.integers(2, 20),
    st.integers(2, 12),
    st.integers(1, 20),
    st.sampled_from([AUDI, DEMO, None]),
    st.randoms(use_true_random=False),
)
def test_winners_are_those_of_the_slot_counter(nodes, count, slots, cluster, random):
    bus = bus_of(nodes, count, min(slots, nodes), cluster)
    bids = [random.choice([NO_BID, random.randint(0, 2 * MOST)]) for _ in range(nodes)]
    waits = [random.choice([0, nodes - 1, nodes, 3 * nodes]) for _ in range(nodes)]
    sizes = [2 * random.randint(4, 34) for _ in range(nodes)]
    state = begin_arbitration(nodes)._replace(waits=np.array(waits))
    awards = bus.arbitrate(state, 0, 0, range(nodes), np.array(bids), lambda: np.array(sizes))
    expected = by_slots(bus, bids, waits, sizes, min(slots, nodes))
    assert sorted(expected) == np.flatnonzero(awards.wins).tolist()
    # The frames lie in the slots in which the senders' classes have their IDs, in this order.
    sent = [size if won else 0 for size, won in zip(sizes, awards.wins, strict=True)]
    frames = bus.transmissions(0, sent, awards.classes.tolist())
    assert [frame.node for frame in frames] == expected


@quick
@given(st.integers(2, 7), st.integers(1, 7), st.permutations(range(7)), st.integers(0, 6))
def test_equal_urgency_alone_depends_on_the_node(nodes, slots, order, shift):
    """Nodes in classes of their own win by class: renaming nodes renames winners."""
    bus = bus_of(nodes, 9, min(slots, nodes))
    step = (MOST / LEAST) ** (1 / 8)
    bids = np.array([round(LEAST * step ** (k + 0.5)) for k in range(nodes)])
    renamed = np.array([one for one in order if one < nodes])
    state = begin_arbitration(nodes)
    wins = bus.arbitrate(state, 0, 0, range(nodes), bids, unasked).wins
    again = bus.arbitrate(state, 0, 0, range(nodes), bids[renamed], unasked).wins
    np.testing.assert_array_equal(again, wins[renamed])
    assert np.flatnonzero(wins).tolist() == list(range(max(0, nodes - slots), nodes))


@pytest.mark.parametrize("cluster", [None, AUDI])
def test_receivers_accept_every_frame_id_of_the_sender_and_no_other(cluster):
    bus, body = bus_of(5, 4, 2, cluster), bytes(range(60))
    seen = set()
    for node in range(5):
        for urgency_class in range(4):
            (frame,) = bus.encode(node, 3, body, urgency_class)
            seen.add(read_frame(frame).frame_id)
            assert bus.due_body(frame, node, 3, len(body)) == body
            assert bus.place(node, bus.receive(frame)).number == 0
            assert bus.urgency_class(node, 3, read_frame(frame).frame_id) == urgency_class
            other = (node + 1) % 5
            assert bus.due_body(frame, other, 3, len(body)) is None
            with pytest.raises(Rejected, match="wrong-slot"):
                bus.place(other, bus.receive(frame))
        # A class that a peer invents counts as the last.
        assert bus.encode(node, 3, body, 99) == bus.encode(node, 3, body, 3)
    first = bus.cluster.first_dynamic_id
    assert seen == set(range(first, first + 20))


def test_shares_of_several_frames_have_consecutive_ids_in_each_class():
    bus = bus_of(3, 2, 1, share_bytes=600)
    lengths = payload_lengths(600)
    for node in range(3):
        for urgency_class in range(2):
            frames = bus.encode(node, 0, bytes(600), urgency_class)
            ids = [read_frame(frame).frame_id for frame in frames]
            first = bus.cluster.first_dynamic_id + (3 * urgency_class + node) * len(lengths)
            assert ids == list(range(first, first + len(lengths)))


@quick
@given(
    st.sampled_from(["urgency", "minislot"]),
    st.integers(2, 8),
    st.sampled_from([300, 600, 900]),
    st.sampled_from([AUDI, DEMO]),
    st.randoms(use_true_random=False),
)
def test_hosts_that_withdraw_change_no_winner_where_shares_are_equally_long(
    arbiter, nodes, share_bytes, cluster, random
):
    """Without withdrawal the frames of a share go one by one, and the last share may be cut."""
    schedule = dynamic_only(nodes, 1.0)
    classes = ONE_CLASS if arbiter == "minislot" else UrgencyClasses(3, LEAST, MOST, nodes)
    bus = flexray_bus(schedule, cluster, share_bytes, ARBITERS[arbiter], classes=classes)
    lengths = payload_lengths(share_bytes, cluster.dynamic_payload_bytes)
    bids = np.array([random.choice([NO_BID, LEAST, MOST]) for _ in range(nodes)])
    state = begin_arbitration(nodes)
    sizes = np.full(nodes, sum(lengths))
    awards = bus.arbitrate(state, 0, 0, range(nodes), bids, lambda: sizes)
    buffers = {
        slot.frame_id: (node, length)
        for node in np.flatnonzero(bids != NO_BID).tolist()
        for slot, length in zip(bus.slots(node, 0)[int(awards.classes[node])], lengths, strict=True)
    }
    sent = [0] * nodes
    slot, minislot = cluster.first_dynamic_id, 1
    while minislot <= cluster.latest_transmission_minislot:
        node, length = buffers.get(slot, (None, 0))
        if node is not None:
            sent[node] += 1
        minislot += 1 if node is None else cluster.dynamic_slot_minislots(length)
        slot += 1
    assert awards.wins.tolist() == [frames == len(lengths) for frames in sent]
    # No more than one share is cut.
    assert sum(0 < frames < len(lengths) for frames in sent) <= 1


@quick
@given(st.integers(2, 8), st.integers(2, 6), st.integers(2, 8), st.data())
def test_relayed_frames_keep_the_order_of_the_slot_counter(nodes, count, slots, data):
    """Classes change from slot to slot; the slot counter of a cycle never goes back."""
    slots = min(slots, nodes)
    plain = dynamic_only(nodes, slots / nodes)
    schedule = Schedule(
        nodes, plain.static_table, plain.contender_table, plain.dynamic_slot_table, True
    )
    cluster = fitted_cluster(schedule, payload_lengths(60), count)
    classes = UrgencyClasses(count, LEAST, MOST, old_after=nodes)
    bus = flexray_bus(schedule, cluster, 60, ARBITERS["urgency"], 0.0, classes)
    state = begin_arbitration(nodes)
    for cycle in range(3):
        sent: list[int] = []
        left = list(range(nodes))
        for group in range(slots):
            bids = np.array(data.draw(st.lists(
                st.integers(NO_BID, 2 * MOST), min_size=len(left), max_size=len(left)
            )))  # fmt: skip
            asks = np.flatnonzero(bids != NO_BID)
            awards = bus.arbitrate(state, cycle, group, left, bids, unasked)
            winners = np.flatnonzero(awards.wins)
            assert len(winners) <= min(1, len(asks))
            state = awards.state
            for place in winners.tolist():
                of_class = bus.slots(left[place], cycle)[int(awards.classes[place])]
                sent.append(of_class[0].frame_id)
                left.pop(place)
        assert sent == sorted(sent)


@pytest.mark.parametrize(
    "values", [(0, 1, 2, 1), (2, 0, 2, 1), (2, 5, 5, 1), (2, 1, 2, 0)], ids=str
)
def test_classes_that_cannot_be_are_refused(values):
    with pytest.raises(ValueError, match="urgency classes of bids"):
        UrgencyClasses(*values)


def test_more_frame_ids_than_flexray_has_are_refused_with_the_number_that_fits():
    with pytest.raises(ValueError, match="--urgency-classes 6"):
        bus_of(300, 8, 1, AUDI)


def test_places_beyond_the_range_of_bids_are_its_end():
    classes = UrgencyClasses(4, LEAST, MOST)
    np.testing.assert_array_equal(classes.spread(np.array([0.0, 0.5, 1.0, 1.5])),
                                  [LEAST, 512, MOST, MOST])  # fmt: skip


def test_the_marks_of_a_cycle_are_its_slots_and_minislots():
    bus = bus_of(3, 2, 1)
    ends, begins = bus.marks_us()
    cluster = bus.cluster
    assert len(ends) == cluster.static_slots - 1 if cluster.static_slots else ends == []
    assert begins == [cluster.minislot_start_us(k + 1) for k in range(cluster.minislots)]
