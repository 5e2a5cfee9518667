"""Records and the frames that carry them: what goes in comes out, and garbage is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.nodes.rules.labelled.frame import Labelled, LabelledFrameCodec, LabelledShare
from concord.nodes.rules.labelled.record_codec import PACKED, RecordCodec, record_codec
from concord.nodes.rules.labelled.record_sets import packed
from concord.nodes.vector_codec import BeliefCodec
from concord.plants.own_sensor import OwnSensor
from concord.plants.range_bearing import RangeBearing
from tests.nodes.networks import random_cov

NUMBERS = ("<i1", "<i2", PACKED, "<f4", "<f8")
SENSOR = RangeBearing(np.zeros(2))
SEEDS = st.integers(0, 2**32 - 1)


def codec_for(number: str, readings: int = 1) -> RecordCodec:
    codec = record_codec(SENSOR, (readings, 2), number)
    assert codec is not None
    return codec


# --- records -------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("readings", [1, 3, 9])
@given(seed=SEEDS)
def test_a_record_says_its_readings_to_half_a_step(number: str, readings: int, seed: int):
    generator = np.random.default_rng(seed)
    codec = codec_for(number, readings)
    delivered = SENSOR.noise_std * generator.uniform(-7, 7, (readings, 2))
    delivered[generator.random((readings, 2)) < 0.3] = np.nan
    record = codec.encode(delivered)
    if np.isnan(delivered).all():
        assert record is None
        return
    assert record is not None and len(record) == codec.length(record) <= codec.size_max
    found = codec.decode(record)
    step = np.full(2, 1e-4) if codec.resolution is None else codec.resolution
    assert np.array_equal(np.isnan(found), np.isnan(delivered))
    assert (np.abs(np.nan_to_num(found - delivered)) <= step / 2 + 1e-12).all()
    # Each node uses the decoded values: encoding them again changes no bit.
    assert codec.encode(found) == record


@pytest.mark.parametrize("number", ["<i2", PACKED])
def test_rounding_has_the_variance_that_everybody_adds(number: str):
    codec = codec_for(number)
    values = SENSOR.noise_std * np.random.default_rng(1).normal(30, 50, (4000, 1, 2))
    errors = np.array([codec.decode(codec.encode(v) or b"")[0] - v[0] for v in values])
    expected = np.diag(codec.rounding_cov)  # type: ignore[arg-type]
    # Of n uniform errors the sum of squares over the variance has mean n, variance 0.8 n.
    deviation = stats.norm.ppf(1 - 1e-6) * np.sqrt(0.8 / len(values))
    assert (np.abs((errors**2).mean(0) / expected - 1) < deviation).all()


@pytest.mark.parametrize(
    "number, deviations", [("<i2", 32765 / 16), (PACKED, 2045 / 4), ("<f4", 2.0**14)]
)
@pytest.mark.parametrize("readings", [1, 3])
def test_a_reading_beyond_the_reach_follows_as_float64(
    number: str, deviations: float, readings: int
):
    codec = codec_for(number, readings)
    most = deviations * SENSOR.noise_std[0]
    delivered = np.full((readings, 2), np.nan)
    delivered[0] = most * 1.01, 0.1
    delivered[-1, 0] = most * 1.02
    record = codec.encode(delivered)
    assert record is not None and len(record) == codec.length(record) <= codec.size_max
    np.testing.assert_array_equal(codec.decode(record), delivered)
    assert codec.beyond(delivered) == min(readings, 2)
    found, length = codec.received(delivered)
    np.testing.assert_array_equal(found, delivered)
    assert length == len(record)
    assert all(codec.length(record[:cut]) > cut for cut in range(len(record)))
    near = np.full((readings, 2), np.nan)
    near[0, 0] = most
    assert codec.beyond(near) == 0


@pytest.mark.parametrize("number", [PACKED, "<i2", "<f4"])
@given(seed=SEEDS)
def test_a_record_is_written_about_the_reading_of_the_origin(number: str, seed: int):
    """A record loses as little far from zero, with an angle on both sides of pi."""
    rng = np.random.default_rng(seed)
    corner = np.array([5e5, 5.4e6])
    sensor = OwnSensor(
        h=lambda x: np.stack((x[..., 1], np.arctan2(x[..., 1], x[..., 0]) + np.pi), axis=-1),
        R=[4e-4, 1e-6],
        angles=(1,),
    )
    codec = record_codec(sensor, (1, 2), number, corner)
    assert codec is not None and codec.rounding_cov is not None
    angle = np.arctan2(corner[1], corner[0]) + np.pi
    taken = np.array([corner[1], angle]) + sensor.noise_std * rng.uniform(-400, 400, 2)
    taken[1] = (taken[1] + np.pi) % (2 * np.pi) - np.pi
    record = codec.encode(taken[None])
    assert record is not None and len(record) < 16
    off = sensor.residual(codec.decode(record)[0], taken)
    step = np.sqrt(12 * np.diagonal(codec.rounding_cov))
    assert (np.abs(off) <= step / 2 + 1e-9).all()
    np.testing.assert_array_equal(codec.received(taken[None])[0], codec.decode(record))


def test_a_sensor_with_an_exact_entry_sends_float64():
    sensor = OwnSensor(h=lambda x: x[..., :2], R=[1.0, 0.0])
    codec = record_codec(sensor, (1, 2), "<i2")
    assert codec is not None and codec.number == "<f8" and codec.rounding_cov is None
    taken = np.array([[0.1, 1e6 / 3]])
    np.testing.assert_array_equal(codec.decode(codec.encode(taken) or b""), taken)


def test_entries_that_no_sensor_of_a_node_has_are_not_written():
    """A delivery has room for the node with most; this one measures two of three."""
    padded = record_codec(SENSOR, (1, 3), "<i2")
    assert padded is not None and padded.size_max == 4 + 16
    delivered = np.array([[100.0, 0.1, np.nan]])
    record = padded.encode(delivered)
    assert record is not None and padded.beyond(delivered) == 0
    found = padded.decode(record)
    np.testing.assert_allclose(found[0, :2], delivered[0, :2], atol=10 / 32)
    assert found.shape == (1, 3) and np.isnan(found[0, 2])
    assert padded.rounding_cov is not None and padded.rounding_cov.shape == (2, 2)
    several = record_codec(SENSOR, (2, 3), "<f8")
    assert several is not None
    delivered = np.array([[np.nan, np.nan, np.nan], [1.0, 2.0, np.nan]])
    np.testing.assert_array_equal(several.decode(several.encode(delivered) or b""), delivered)


# --- frames --------------------------------------------------------------------------------------


def frames(digest_steps: int, limit_bytes: int = 246) -> LabelledFrameCodec:
    """Five nodes, of which node 3 is blind; node 4 has two readings."""
    codecs = [codec_for("<i2"), codec_for(PACKED), codec_for("<f8"), None, codec_for("<i2", 2)]
    return LabelledFrameCodec(codecs, BeliefCodec(2, "<f4"), 10, digest_steps, limit_bytes)


@st.composite
def shares(draw: st.DrawFn, digest_steps: int) -> LabelledShare:
    generator = np.random.default_rng(draw(SEEDS))
    codec = frames(digest_steps)
    records = []
    for source in draw(st.lists(st.sampled_from([0, 1, 2, 4]), max_size=8)):
        of_source = codec.codecs[source]
        assert of_source is not None
        readings = SENSOR.noise_std * generator.uniform(-5, 5, (of_source.readings, 2))
        record = of_source.encode(readings)
        assert record is not None
        records.append(Labelled(source, draw(st.integers(0, 9)), record))
    checkpoint = None
    if draw(st.booleans()):
        mean, cov = generator.standard_normal(2), random_cov(generator, 2)
        checkpoint = Gaussian(mean.astype("f4").astype(float), cov.astype("f4").astype(float))
    digest = tuple(draw(st.integers(0, 31)) for _ in range(digest_steps))
    return LabelledShare(draw(st.booleans()), checkpoint, digest, tuple(records))


@pytest.mark.parametrize("digest_steps", [0, 1, 8])
@given(data=st.data())
def test_a_share_comes_back(digest_steps: int, data: st.DataObject):
    share, codec = data.draw(shares(digest_steps)), frames(digest_steps)
    body = codec.encode(share)
    found = codec.decode(body)
    # Records of the mask come before those with a label, and in the digest's order.
    assert sorted(found.records) == sorted(share.records)
    nothing: dict = {"checkpoint": None, "records": ()}
    assert found._replace(**nothing) == share._replace(**nothing)
    assert codec.encode(found) == body
    assert (found.checkpoint is None) == (share.checkpoint is None)
    if share.checkpoint is not None and found.checkpoint is not None:
        assert np.array_equal(found.checkpoint.mean, share.checkpoint.mean)
        assert np.array_equal(found.checkpoint.cov, share.checkpoint.cov)
    if len(set(share.records)) < len(share.records):
        return
    # Bytes are those that the choice of records counts with.
    held = np.zeros((10, 5), dtype=bool)
    for age, sources in enumerate(share.digest):
        held[9 - age] = [sources >> source & 1 for source in range(5)]
    room = codec.room(packed(held), np.array(share.checkpoint is not None))
    masked = [(s, a) for s, a, _ in share.records if a < digest_steps and held[9 - a, s]]
    labels = len(share.records) - len(set(masked))
    assert len(body) == codec.limit_bytes - room + 2 * labels + sum(
        len(record) for _, _, record in share.records
    )


@given(st.data(), st.integers(0, 300))
def test_a_share_that_is_cut_is_refused(data: st.DataObject, length: int):
    share, codec = data.draw(shares(1)), frames(1)
    body = codec.encode(share)
    if length < len(body):
        with pytest.raises(Rejected):
            codec.decode(body[:length])


@given(st.binary(max_size=80))
def test_garbage_is_a_share_or_refused(body: bytes):
    codec = frames(3)
    try:
        share = codec.decode(body)
    except Rejected:
        return
    for source, age, record in share.records:
        of_source = codec.codecs[source]
        assert of_source is not None and age < 10
        assert of_source.decode(record).shape == (of_source.readings, 2)


@pytest.mark.parametrize("source, age", [(3, 0), (5, 0), (0, 10)])
def test_labels_that_nobody_writes_are_refused(source: int, age: int):
    body = bytes((0, 1, source, age)) + bytes(40)
    with pytest.raises(Rejected, match="labelled-label"):
        frames(0).decode(body)


@pytest.mark.parametrize(
    ("digest", "mask", "reason"),
    [
        (b"\xe1", b"", "labelled-mask"),  # source 0 of five is listed, and more bits are set
        (b"\x01", b"", "labelled-mask"),  # source 0 is listed, and none of its records is held
        (b"\x63", b"\x04", "labelled-mask"),  # a third record of two
        (b"\x63", b"", "labelled-length"),
        (b"\x28", b"\x01", "labelled-label"),  # of the blind node
    ],
)
def test_masks_that_no_node_writes_are_refused(digest: bytes, mask: bytes, reason: str):
    with pytest.raises(Rejected, match=reason):
        frames(1).decode(bytes((0, 0)) + digest + mask)


def test_a_record_of_the_digest_takes_a_bit_for_its_label():
    codec = frames(1)
    # Node 4 has two readings: its record begins with a byte that says which it took.
    records = (Labelled(0, 0, bytes(4)), Labelled(4, 0, b"\x01" + bytes(4)))
    share = LabelledShare(False, None, (0b10001,), records)
    assert len(codec.encode(share)) == 2 + 1 + 1 + 4 + 5
    apart = share._replace(digest=(0,))
    assert len(codec.encode(apart)) == 2 + 1 + 0 + (2 + 4) + (2 + 5)
    assert codec.decode(codec.encode(apart)).records == share.records


def test_a_frame_that_cannot_hold_a_checkpoint_is_refused_before_the_start():
    with pytest.raises(ValueError, match="--payload-bytes by 4 or more"):
        frames(0, limit_bytes=41)
