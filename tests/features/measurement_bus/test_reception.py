"""Sensors and receiver of a measurement bus, alone: what each makes of its events."""

import numpy as np
import pytest

from concord.features.measurement_bus.gaussian_receiver import GaussianReceiver
from concord.features.measurement_bus.measurement_bus import bid, zero_input, zero_order_hold
from concord.features.measurement_bus.measurement_codec import MeasurementCodec
from concord.features.measurement_bus.reception import ReceiverNode, SensorNode
from concord.features.measurement_bus.stochastic import StochasticNonlinearity, StochasticSystem
from concord.features.measurement_bus.stochastic_ukf import RECOMMENDED
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.estimator import Rejected
from concord.nodes.messages import Measured
from concord.papers.meng2025.filter_as_printed import PAPER_LITERAL, PAPER_LITERAL_R

SYSTEM = StochasticSystem(
    transition=lambda x, u, s: 0.9 * x + (0.0 if u is None else u),
    measure=lambda x, s: np.stack([x[..., 0], x[..., 1], x[..., 0] + x[..., 1]], axis=-1),
    sizes=(2, 1),
    process_noise_cov=lambda s: 0.1 * np.eye(2),
    measurement_noise_cov=lambda s: 0.2 * np.eye(3),
    process=lambda s: StochasticNonlinearity(2, 2),
    measurement=lambda s: StochasticNonlinearity(3, 2),
)
PRIOR = Gaussian(np.array([1.0, -1.0]), np.eye(2))


def sensor(silent=zero_order_hold, number: str = "<f8") -> SensorNode:
    held = np.array([1.0, -1.0])
    weight = np.diag([1.0, 4.0])
    return SensorNode(2, 1, held, lambda _: weight, silent, MeasurementCodec(2, number), 1)


def receiver(method=RECOMMENDED, prior: Gaussian = PRIOR) -> ReceiverNode:
    held = SYSTEM.measure(PRIOR.mean, 0)
    points = scaled_unscented(2)
    own = GaussianReceiver(SYSTEM, method, points, prior)
    return ReceiverNode(own, held, zero_order_hold, MeasurementCodec(2), first_slot=1)


def measured(step: int, *values: float | None) -> Measured:
    return Measured(1, step, [list(values)])


# --- the wire ------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", ["<f8", "<f4"])
def test_a_measurement_comes_back(number: str):
    codec = MeasurementCodec(3, number)
    body = codec.encode(np.array([0.5, -1.25]))
    assert len(body) == codec.size
    np.testing.assert_array_equal(codec.decode(body + b"padding"), [0.5, -1.25, np.nan])


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"", "measurement-length"),
        (bytes(15), "measurement-length"),
        (np.array([1.0, np.inf]).tobytes(), "measurement-infinite"),
    ],
)
def test_what_is_no_measurement_is_rejected(body: bytes, reason: str):
    for node in (sensor(), receiver()):
        with pytest.raises(Rejected) as rejected:
            node.accept(body)
        assert rejected.value.reason == reason


# --- a sensor ------------------------------------------------------------------------------------


def number_of(urgency: float) -> int:
    """The bid of a weighted squared change."""
    return int(bid(np.array([1.0]), np.array([[urgency]])))


def test_a_sensor_bids_with_its_weighted_change_since_it_sent():
    node = sensor()
    content, _ = node.begin_step(node.start(), measured(1, 1.5, -3.0))
    assert node.bid(content) == number_of(0.5**2 + 4 * 2.0**2)
    content, body = node.compose(content)
    content, _ = node.fuse(content, (None,))
    np.testing.assert_array_equal(node.accept(body), [1.5, -3.0])
    content, _ = node.begin_step(content, measured(2, 1.5, -3.0))
    assert node.bid(content) == 0


@pytest.mark.parametrize(
    ("node", "second", "change"),
    [(sensor(), (3.0, -1.0), 2.0), (sensor(zero_input), (3.0, 0.0), 3.0)],
    ids=["from what it sent", "from zero"],
)
def test_a_sensor_that_lost_measures_its_change(node, second: tuple[float, float], change: float):
    content, _ = node.begin_step(node.start(), measured(1, 2.0, -1.0))
    content, _ = node.fuse(content, (None,))
    content, _ = node.begin_step(content, measured(2, *second))
    assert node.bid(content) == number_of(change**2)


def test_nothing_measured_is_nothing_to_ask_for():
    node = sensor()
    content, _ = node.begin_step(node.start(), measured(0, None, None))
    assert node.bid(content) is None
    # A static slot comes round all the same.
    content, body = node.compose(content)
    assert np.isnan(node.accept(body)).all()
    content, _ = node.fuse(content, (None,))
    np.testing.assert_array_equal(content.held, [1.0, -1.0])


def test_a_sensor_knows_what_a_short_number_made_of_its_measurement():
    node = sensor(number="<f4")
    content, _ = node.begin_step(node.start(), measured(1, 1 / 3, -1.0))
    content, body = node.compose(content)
    content, _ = node.fuse(content, (None,))
    assert content.held[0] == node.accept(body)[0] != 1 / 3


def test_a_sensor_believes_nothing():
    node = sensor()
    belief = node.belief(node.start())
    assert belief.mean.shape == (2,) and belief.cov.shape == (2, 2)
    assert np.isnan(belief.mean).all() and np.isnan(belief.cov).all()
    assert node.ages(node.start()).tolist() == [-1]


# --- the receiver --------------------------------------------------------------------------------


def step_of(node: ReceiverNode, content, step: int, *shares, control=None):
    content, first = node.begin_step(content, Measured(0, step, [[None, None]], control))
    content, second = node.fuse(content, shares)
    return content, first + second


def test_at_step_zero_it_believes_the_prior():
    node = receiver()
    content, failures = step_of(node, node.start(), 0, np.array([5.0, 5.0]), None)
    assert failures == ()
    np.testing.assert_array_equal(node.belief(content).mean, PRIOR.mean)
    assert node.ages(content).tolist() == [-1, -1]


def test_silence_is_prediction_and_control_is_heard():
    node = receiver()
    content, _ = step_of(node, node.start(), 1, None, None, control=[0.5, 0.0])
    np.testing.assert_allclose(node.belief(content).mean, 0.9 * PRIOR.mean + [0.5, 0.0])
    np.testing.assert_allclose(node.belief(content).cov, (0.81 + 0.1) * np.eye(2), atol=1e-15)


def test_a_share_moves_the_belief_and_ages_count_slots():
    node = receiver()
    content, _ = step_of(node, node.start(), 1, None, np.array([0.4, np.nan]))
    assert node.ages(content).tolist() == [-1, 0]
    np.testing.assert_array_equal(content.received, [1.0, -1.0, 0.4])
    silent, _ = step_of(node, node.start(), 1, None, None)
    assert np.trace(node.belief(content).cov) < np.trace(node.belief(silent).cov)
    content, _ = step_of(node, content, 2, np.array([1.0, 2.0]), None)
    assert node.ages(content).tolist() == [0, 1]
    np.testing.assert_array_equal(content.received, [1.0, 2.0, 0.4])


def test_half_a_measurement_is_none():
    node = receiver()
    content, _ = step_of(node, node.start(), 1, np.array([1.0, np.nan]), np.array([np.nan, np.nan]))
    silent, _ = step_of(node, node.start(), 1, None, None)
    np.testing.assert_array_equal(node.belief(content).mean, node.belief(silent).mean)
    assert node.ages(content).tolist() == [-1, -1]


@pytest.mark.parametrize("method", [RECOMMENDED, PAPER_LITERAL, PAPER_LITERAL_R])
def test_a_filter_that_breaks_down_says_so_once_and_goes_on(method):
    node = receiver(method, Gaussian(PRIOR.mean, np.diag([1.0, -1.0])))
    content, failures = step_of(node, node.start(), 1, np.array([1.0, 2.0]), None)
    assert failures == ("predict-failed",)
    assert np.isnan(node.belief(content).mean).all()
    assert step_of(node, content, 2, None, np.array([1.0, np.nan]))[1] == ()
