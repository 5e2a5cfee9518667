"""Test scans as records: what readers get, and the lengths of what is written."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.several_targets.scan_codec import ScanCodec, scan_codec, scan_rows

LEAST, MOST, NOISE = np.array([0.0, -3.0]), np.array([300.0, 3.0]), np.array([10.0, 0.05])


def codec(room_bytes: int = 60) -> ScanCodec:
    return scan_codec(LEAST, MOST, NOISE, room_bytes)


@given(st.integers(0, 29), st.integers(0, 2**32 - 1), st.integers(0, 5))
def test_readers_get_the_detections_to_half_a_step(count: int, seed: int, unused: int):
    rng = np.random.default_rng(seed)
    detections = rng.uniform(LEAST, MOST, (count, 2))
    written = codec()
    assert written.readings == 29
    record = written.encode(scan_rows(detections, count + unused))
    assert record is not None
    assert len(record) == written.length(record) == written.length(record + b"more")
    assert len(record) <= written.size_max <= 60
    read = written.detections(record)
    nearest = detections[np.argsort(detections[:, 0])]
    assert read.shape == detections.shape
    assert (np.abs(read - nearest) <= 0.5001 * written.resolution).all()
    # Rounding again changes nothing: the source reads its own record as all others do.
    again = written.encode(scan_rows(read, count))
    assert again is not None
    np.testing.assert_array_equal(np.sort(written.detections(again), 0), np.sort(read, 0))
    found, lengths = written.received(scan_rows(detections, written.readings)[None])
    np.testing.assert_array_equal(found[0], written.decode(record))
    assert lengths.tolist() == [len(record)]


def test_rounding_adds_little_to_the_noise_and_is_known():
    written = codec()
    assert (np.diagonal(written.rounding_cov) < 0.0134 * NOISE**2).all()
    rng = np.random.default_rng(1)
    detections = rng.uniform(LEAST, MOST, (20, 1000, 2))
    errors = []
    for some in detections:
        some = some[: written.readings]
        record = written.encode(scan_rows(some, len(some)))
        assert record is not None
        errors.append(written.detections(record) - some[np.argsort(some[:, 0])])
    variance = np.concatenate(errors).var(axis=0)
    np.testing.assert_allclose(variance, np.diagonal(written.rounding_cov), rtol=0.15)


def test_an_empty_scan_is_a_record_and_no_scan_is_none():
    written = codec()
    empty = written.encode(scan_rows(np.empty((0, 2)), 4))
    assert empty == b"\x00" and written.detections(empty).shape == (0, 2)
    assert written.encode(np.full((5, 2), np.nan)) is None
    found, lengths = written.received(np.full((3, 5, 2), np.nan))
    assert np.isnan(found).all() and not lengths.any()


def test_a_scan_with_too_many_detections_keeps_the_nearest():
    written = codec(room_bytes=8)
    detections = np.stack((np.linspace(290, 10, 9), np.zeros(9)), axis=-1)
    assert written.beyond(scan_rows(detections, 9)) == 9 - written.readings > 0
    record = written.encode(scan_rows(detections, 9))
    assert record is not None and len(record) <= 8
    kept = written.detections(record)
    np.testing.assert_allclose(kept[:, 0], detections[::-1][: written.readings, 0], atol=2)


def test_cut_records_are_known_by_their_length():
    written = codec()
    record = written.encode(scan_rows(np.array([[100.0, 1], [200, 2]]), 2))
    assert record is not None
    for end in range(len(record)):
        assert written.length(record[:end]) > end
    # More detections than any node writes.
    assert written.length(bytes((written.readings + 1,)) + bytes(500)) > 501


def test_a_record_without_room_is_refused():
    with pytest.raises(ValueError, match=r"has 2 bytes for a scan, and one detection takes 3"):
        codec(room_bytes=2)
