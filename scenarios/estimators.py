"""How a rule's estimator is built at one node's place in the network."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from filters import diffusion, hybrid_consensus, information_weighted, kalman_consensus
from filters.fusion import Averaged, Directly
from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule
from filters.trimmed import trimmed_intersection
from nodes.belief_codec import BeliefCodec
from nodes.belief_consensus import BeliefConsensus, HoldPolicy
from nodes.estimator import Estimator
from nodes.fresh_consensus import FreshConsensus, FreshRule
from nodes.information_rounds import InformationRounds
from nodes.labelled import LabelledFlooding
from nodes.local_filter import Model, Sensor
from nodes.messages import Array
from nodes.novelty_rounds import NoveltyRounds
from nodes.vector_codec import VectorCodec
from nodes.window_filter import WindowFilter
from scenarios.labelled import Everybody, frame_codec, gates_of


class Beginning(NamedTuple):
    """The first step of an estimator, and the communication cycle with which it begins."""

    step: int = 0
    cycle: int = 0


class Seat(NamedTuple):
    """A node's place in the network: all that its estimator is built from.

    `neighbours` are whom each node of the network hears; `weights` (1 + J,) the node's own weight
    first, then those of its neighbours; `number` is "<f8" or "<f4"; so many of its neighbours may
    be `liars`; `everybody` tells what rules need to know that use the readings of others.
    """

    node: int
    neighbours: Sequence[Sequence[int]]
    weights: Array
    model: Model
    sensor: Sensor | None
    prior: Gaussian
    points: SigmaPointRule
    hold: HoldPolicy
    trigger: float
    number: str
    liars: int = 0
    everybody: Callable[[], Everybody] | None = None
    beginning: Beginning = Beginning()


def averaging(average: Callable[[Gaussian, Array], Gaussian], seat: Seat) -> Estimator:
    """For rules that average beliefs, fresh ones and held ones."""
    return averaging_numbers(Directly(average), seat)


def averaging_numbers(rule: Averaged, seat: Seat) -> Estimator:
    """For those of them whose averages are of numbers, which one factorisation gives."""
    states = len(seat.prior.mean)
    return BeliefConsensus(
        model=seat.model,
        sensor=seat.sensor,
        prior=seat.prior,
        points=seat.points,
        rule=rule,
        hold=seat.hold,
        weights=seat.weights,
        codec=BeliefCodec(states, seat.number),
        trigger=seat.trigger,
    )


def trimmed(seat: Seat) -> Estimator:
    """For covariance intersection among liars: what they claim of themselves gives no weight."""
    average = partial(trimmed_intersection, liars=seat.liars)
    return averaging(average, seat._replace(hold=seat.hold._replace(by_sharpness=False)))


def hybrid(gain: hybrid_consensus.Gain, seat: Seat) -> Estimator:
    """For consensus on prior and novelty."""
    states = len(seat.prior.mean)
    rule = InformationRounds(
        partial(hybrid_consensus.begin, row=np.eye(len(seat.neighbours))[seat.node]),
        partial(hybrid_consensus.conclude, states=states, gain=gain),
        partial(hybrid_consensus.sound, states=states),
        seat.weights,
    )
    return _fresh(rule, seat)


def weighted_information(seat: Seat) -> Estimator:
    """For information-weighted consensus."""
    nodes = len(seat.neighbours)
    rule = InformationRounds(
        partial(information_weighted.begin, nodes=nodes),
        partial(information_weighted.conclude, nodes=nodes),
        information_weighted.sound,
        seat.weights,
    )
    return _fresh(rule, seat)


def diffused(seat: Seat) -> Estimator:
    """For diffusion; on a complete graph with one round it is the centralised filter."""
    mix = partial(diffusion.combine, weights=seat.weights)
    return _fresh(NoveltyRounds(diffusion.begin, diffusion.incremental, mix), seat)


def pulled(seat: Seat) -> Estimator:
    """For the Kalman-consensus filter."""
    rate = kalman_consensus.largest_rate(max(len(heard) for heard in seat.neighbours))
    rule = NoveltyRounds(
        kalman_consensus.begin,
        partial(kalman_consensus.correct, rate=rate),
        partial(kalman_consensus.average, rate=rate),
    )
    return _fresh(rule, seat)


def flooding(seat: Seat) -> Estimator:
    """For labelled measurements."""
    assert seat.everybody is not None, "whoever seats a node of this rule knows all nodes"
    everybody = seat.everybody()
    frames = frame_codec(everybody, seat.neighbours, len(seat.prior.mean))
    return LabelledFlooding(
        node=seat.node,
        neighbours=seat.neighbours,
        prior=seat.prior,
        filter=WindowFilter(seat.model, everybody.sensors, frames.codecs, seat.points),
        frames=frames,
        schedule=everybody.schedule,
        rounds=everybody.scenario.rounds,
        gates=gates_of(everybody.scenario, everybody.readings_shape[1]),
        first_step=seat.beginning.step,
        first_cycle=seat.beginning.cycle,
    )


def _fresh(rule: FreshRule, seat: Seat) -> Estimator:
    """For a rule that uses fresh shares alone."""
    numbers = len(rule.begin(seat.prior, seat.prior))
    return FreshConsensus(
        model=seat.model,
        sensor=seat.sensor,
        prior=seat.prior,
        points=seat.points,
        rule=rule,
        neighbours=len(seat.neighbours[seat.node]),
        codec=VectorCodec(numbers, seat.number),
        trigger=seat.trigger,
    )
