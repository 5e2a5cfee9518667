"""How a rule is built at all nodes of many runs at once: `scenarios.estimators` in arrays."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from filters import diffusion, hold, hybrid_consensus, information_weighted, kalman_consensus
from filters.fusion import MOMENTS, Averaging
from nodes.belief_consensus import HoldPolicy
from nodes.labelled import GAP_STEPS
from nodes.novelty_rounds import NoveltyRounds
from nodes.vectorised_beliefs import BeliefFleet
from nodes.vectorised_filter import LocalFilters
from nodes.vectorised_fresh import (
    FreshExchange,
    FreshFleet,
    InformationExchange,
    NoveltyExchange,
)
from nodes.vectorised_labelled import LabelledFleet
from nodes.vectorised_links import Links, Shares
from nodes.vectorised_network import Fleet
from nodes.vectorised_window import WindowFilters
from scenarios.labelled import Everybody, frame_codec, gates_of


class FleetSeat(NamedTuple):
    """All that the array form of a rule is built from.

    `base` are the weights of a run, `contenders` (C,) the nodes that may ask for the dynamic
    segment; `number` is "<f8" or "<f4"; `neighbours` and `everybody` are as in
    `scenarios.estimators.Seat`.
    """

    filters: LocalFilters
    links: Links
    base: Shares
    hold: HoldPolicy
    rounds: int
    contenders: np.ndarray
    trigger: float
    number: str
    neighbours: Sequence[Sequence[int]]
    everybody: Callable[[], Everybody]


def local_fleet(seat: FleetSeat) -> Fleet:
    """For the rule that fuses nothing."""
    nobody = seat.hold._replace(
        weigh=lambda base, ages, _sharpness, _cycles: hold.alone(base, ages), by_sharpness=False
    )
    return averaging_fleet(MOMENTS, seat._replace(hold=nobody))


def averaging_fleet(averaging: Averaging, seat: FleetSeat) -> Fleet:
    """For rules that average beliefs."""
    return BeliefFleet(
        filters=seat.filters,
        averaging=averaging,
        hold=seat.hold,
        links=seat.links,
        base=seat.base,
        rounds=seat.rounds,
        contenders=seat.contenders,
        number=seat.number,
        trigger=seat.trigger,
    )


def hybrid_fleet(gain: hybrid_consensus.Gain, seat: FleetSeat) -> Fleet:
    """For consensus on prior and novelty."""
    states = seat.filters.points.unit_points.shape[-1]
    rule = InformationExchange(
        partial(hybrid_consensus.begin, row=np.eye(seat.links.nodes)),
        partial(hybrid_consensus.conclude, states=states, gain=gain),
        partial(hybrid_consensus.sound, states=states),
        seat.links,
        seat.base,
    )
    return _fresh(rule, seat)


def weighted_information_fleet(seat: FleetSeat) -> Fleet:
    """For information-weighted consensus."""
    nodes = seat.links.nodes
    rule = InformationExchange(
        partial(information_weighted.begin, nodes=nodes),
        partial(information_weighted.conclude, nodes=nodes),
        information_weighted.sound,
        seat.links,
        seat.base,
    )
    return _fresh(rule, seat)


def diffused_fleet(seat: FleetSeat) -> Fleet:
    """For diffusion and the centralised filter."""
    rules = tuple(
        NoveltyRounds(
            diffusion.begin, diffusion.incremental, partial(diffusion.combine, weights=weights[0])
        )
        for weights in seat.links.rows(seat.base)
    )
    return _fresh(NoveltyExchange(rules, seat.links), seat)


def pulled_fleet(seat: FleetSeat) -> Fleet:
    """For the Kalman-consensus filter."""
    most = int(np.diff(seat.links.offsets).max())
    rate = kalman_consensus.largest_rate(most)
    rule = NoveltyRounds(
        kalman_consensus.begin,
        partial(kalman_consensus.correct, rate=rate),
        partial(kalman_consensus.average, rate=rate),
    )
    return _fresh(NoveltyExchange((rule,) * len(seat.links.classes), seat.links), seat)


def flooding_fleet(seat: FleetSeat) -> Fleet:
    """For labelled measurements, in scenarios that `scenarios.labelled.without_arrays` has none
    to name of."""
    everybody = seat.everybody()
    states = seat.filters.points.unit_points.shape[-1]
    frames = frame_codec(everybody, seat.neighbours, states)
    codecs = tuple(codec for codec in frames.codecs if codec is not None)
    channels = everybody.readings_shape[1]
    return LabelledFleet(
        WindowFilters(seat.filters, codecs, frames.window_steps, channels),
        frames,
        seat.links,
        everybody.schedule,
        seat.rounds,
        GAP_STEPS,
        gates_of(everybody.scenario, channels),
    )


def _fresh(rule: FreshExchange, seat: FleetSeat) -> Fleet:
    return FreshFleet(seat.filters, rule, seat.links, seat.contenders, seat.number, seat.trigger)
