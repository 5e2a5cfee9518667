"""Test the fusion of the tracks of two nodes."""

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.several_targets.scan_codec import scan_codec
from concord.features.several_targets.scanning import ScanningSensor
from concord.features.several_targets.swarm_tracking import settings_of
from concord.features.several_targets.track_codec import TrackCodec, TrackShare
from concord.features.several_targets.tracking.track_fusion import (
    ENDED_STEPS,
    LookedAt,
    fused_tracks,
    tracked_on,
)
from concord.features.several_targets.tracking.tracker import Scan
from concord.features.several_targets.tracking.tracks import Tracks
from concord.filters.fusion.determinant_intersection import determinant_intersection
from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.plants.range_bearing import RangeBearing
from concord.scenarios.scenario_options import scenario_of


def tracks(*rows: Sequence[float]) -> LookedAt:
    """Tracks of rows (place in m, label, existence, step of the last look), confirmed."""
    values = np.array(rows, dtype=float).reshape(-1, 4)
    mean = np.zeros((len(values), 4))
    mean[:, 0], mean[:, 3] = values[:, 0], 7.0
    cov = np.diag([25.0, 4, 30, 3]) + 0.5
    identity = np.column_stack((values[:, 1], values[:, 1] % 3, 0 * values[:, 1])).astype(int)
    kept = Tracks(
        Gaussian(mean, np.tile(cov, (len(values), 1, 1))),
        values[:, 2],
        identity,
        np.ones(len(values), dtype=bool),
    )
    return LookedAt(kept, values[:, 3].astype(int))


def codec_of(most: int) -> TrackCodec:
    """Shares of so many tracks, and of a scan of up to 9 detections."""
    spans = np.array([0.0, -3.2]), np.array([400.0, 3.2])
    return TrackCodec(4, most, scan_codec(*spans, np.array([10.0, 0.035]), 20))


def labels(known: LookedAt) -> list[int]:
    return known.tracks.identity[:, 0].tolist()


def test_a_neighbour_that_did_not_look_later_votes_for_nothing():
    own, late, early = tracks((0, 1, 0.9, 5)), tracks((3, 2, 0.2, 6)), tracks((3, 2, 0.2, 4))
    assert fused_tracks(own, early).tracks.existence.tolist() == [0.9]
    assert fused_tracks(own, late).tracks.existence.tolist() == [0.2]
    assert fused_tracks(own, late).looked.tolist() == [6]
    # Odds of 4 and 1/4, looked at in one step.
    both = fused_tracks(tracks((0, 1, 0.8, 5)), tracks((3, 2, 0.2, 5)))
    assert both.tracks.existence == pytest.approx([0.5])


def test_a_track_that_has_just_begun_does_not_vote_a_confirmed_one_down():
    own = tracks((0, 4, 0.02, 5))
    begun = own._replace(tracks=own.tracks._replace(confirmed=np.array([False])))
    found = fused_tracks(begun, tracks((3, 2, 0.97, 5))).tracks
    assert found.existence.tolist() == [0.97] and found.confirmed.all()


def test_one_target_takes_the_older_label_and_the_fused_belief():
    own, heard = tracks((0, 4, 0.9, 5)), tracks((6, 2, 0.9, 5))
    found = fused_tracks(own, heard)
    assert labels(found) == [2]
    expected = determinant_intersection(own.tracks.belief, heard.tracks.belief)
    for ours, known in zip(found.tracks.belief, expected, strict=True):
        np.testing.assert_array_equal(ours, known)


def test_targets_apart_are_taken_over_if_they_stand_for_targets():
    own = tracks((0, 4, 0.9, 5))
    found = fused_tracks(own, tracks((500, 2, 0.9, 5), (900, 3, 0.4, 5)))
    assert labels(found) == [2, 4] and found.tracks.belief.mean[:, 0].tolist() == [500, 0]


def test_a_label_is_never_given_twice():
    # The neighbour's track with the label 1 is near our track with the label 2.
    found = fused_tracks(tracks((0, 1, 0.9, 5), (200, 2, 0.9, 5)), tracks((205, 1, 0.9, 6)))
    assert labels(found) == [1, 2]
    # Equal labels are one target: the later look says where it is.
    assert found.tracks.belief.mean[:, 0].tolist() == [205, 200]
    # At the very place of our other track the neighbour's is that one, and its label is taken.
    found = fused_tracks(tracks((0, 1, 0.9, 5), (200, 2, 0.9, 5)), tracks((200, 1, 0.9, 6)))
    assert sorted(labels(found)) == [1, 2]
    early = fused_tracks(tracks((0, 1, 0.9, 5)), tracks((200, 1, 0.9, 4)))
    assert early.tracks.belief.mean[:, 0].tolist() == [0]


def test_the_end_of_a_track_is_told_for_some_steps():
    settings = settings_of(scenario_of("target-swarm"))
    # The target is gone: three sensors look at its place and see nothing.
    places = ((0.0, -50.0), (0.0, 60.0), (40.0, 0.0), (5000.0, 0.0))
    scans = [
        Scan(number, ScanningSensor(RangeBearing(np.array(place))), np.empty((0, 2)))
        for number, place in enumerate(places)
    ]
    # A track that no sensor sees stays.
    known = tracks((0, 1, 0.99, 5), (2000, 2, 0.99, 5))
    for step in range(6, 6 + ENDED_STEPS):
        known, _ = tracked_on(known, scans, settings, step)
        assert labels(known) == [1, 2] and known.looked.tolist() == [6, 5]
        assert known.tracks.existence[0] == 0 and known.tracks.existence[1] > 0.9
        heard = fused_tracks(tracks((3, 1, 0.99, 5)), known).tracks
        assert heard.existence[0] < 0.5
    known, _ = tracked_on(known, scans, settings, 6 + ENDED_STEPS)
    assert labels(known) == [2]


rows = st.lists(
    st.tuples(
        st.floats(0, 1000), st.integers(0, 40), st.floats(0.01, 0.99), st.integers(0, 9)
    ),
    max_size=6,
    unique_by=lambda row: row[1],
)  # fmt: skip


@given(rows, rows)
@settings(max_examples=100, deadline=None)
def test_fusion_keeps_what_is_known_and_adds_nothing_twice(mine: list, theirs: list):
    own, heard = (tracks(*sorted(some, key=lambda row: row[1])) for some in (mine, theirs))
    found = fused_tracks(own, heard)
    assert len(set(labels(found))) == len(labels(found)) >= len(mine)
    assert labels(found) == sorted(labels(found))
    assert ((found.tracks.existence >= 0) & (found.tracks.existence <= 1)).all()
    again = fused_tracks(own, own)
    for ours, known in zip(again.tracks.belief, own.tracks.belief, strict=True):
        np.testing.assert_array_equal(ours, known)


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_labels_agree_after_as_many_rounds_as_the_graph_is_wide(order: tuple[int, ...]):
    # A path of three nodes, each with labels of its own for two targets.
    known = [
        tracks((0, 10 + number, 0.9, 5), (400, 20 + number, 0.9, 5)) for number in np.argsort(order)
    ]
    for _ in range(2):
        said = list(known)
        for node, near in enumerate(((1,), (0, 2), (1,))):
            for other in near:
                known[node] = fused_tracks(known[node], said[other])
    assert [labels(one) for one in known] == [[10, 20]] * 3


def test_tracks_come_over_the_wire_with_a_covariance_that_is_not_too_small():
    sent = tracks((0.37, 4, 0.91, 5), (712.3, 70000, 0.6, 1))
    codec = codec_of(3)
    scan = np.array([[2, np.nan], [120, 1.0], [300, -2.0]])
    record = codec.scans.encode(scan)
    body = codec.encode(TrackShare(sent, record), 9)
    assert len(body) == 1 + 2 * 37 + 5 and codec.size == 1 + 3 * 37 + codec.scans.size_max
    read, came = codec.decode(body + bytes(8), 9)
    assert came == record
    assert codec.decode(codec.encode(TrackShare(sent, None), 9), 9).record is None
    assert labels(read) == [4, 70000] and read.looked.tolist() == [5, 1]
    assert read.tracks.existence == pytest.approx(sent.tracks.existence, abs=1e-5)
    away = read.tracks.belief.mean - sent.tracks.belief.mean
    spare = read.tracks.belief.cov - sent.tracks.belief.cov - away[:, :, None] * away[:, None, :]
    assert (np.linalg.eigvalsh(spare) > 0).all()


def test_a_share_without_room_has_the_tracks_that_most_probably_exist():
    many = tracks((0, 1, 0.6, 5), (200, 2, 0.9, 5), (400, 3, 0.8, 5))
    codec = codec_of(2)
    body = codec.encode(TrackShare(many, None), 5)
    assert labels(codec.decode(body, 5).known) == [2, 3]


def test_shares_that_no_node_writes_are_refused():
    codec = codec_of(3)
    body = codec.encode(TrackShare(tracks((0, 4, 0.9, 5)), None), 9)
    twice = b"\x02" + 2 * body[1:-1] + body[-1:]
    for broken, says in (
        (b"", "tracks-length"),
        (body[:-1], "tracks-length"),
        (b"\x09" + bytes(999), "tracks-length"),
        (body[:-1] + b"\x09", "tracks-length"),
        (twice, "tracks-label"), (body[:10] + b"\xff" * 29, "tracks-belief"),
    ):  # fmt: skip
        with pytest.raises(Rejected, match=says):
            codec.decode(broken, 9)


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_any_bytes_are_tracks_or_refused(body: bytes):
    try:
        read = codec_of(3).decode(body, 5).known
    except Rejected:
        return
    found = fused_tracks(tracks((0, 4, 0.9, 5)), read)
    assert np.isfinite(found.tracks.belief.mean).all()
