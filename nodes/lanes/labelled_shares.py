"""Shares of the rule `labelled` in arrays: what nodes send at once, and where it comes."""

from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.nodes.lanes.links import Links
from concord.nodes.rules.labelled.record_sets import RecordSets
from concord.nodes.rules.local_filter import finite_lanes
from concord.nodes.vector_codec import BeliefCodec, belief_numbers, belief_of


class Shared(NamedTuple):
    """Shares of lanes (L,): node `nodes` of run `runs` each.

    Their content: records (L, W, B), whether there is a checkpoint (L,), and which it is (L, ...).
    """

    runs: np.ndarray
    nodes: np.ndarray
    records: RecordSets
    with_checkpoint: np.ndarray
    checkpoint: Gaussian


class Came(NamedTuple):
    """Shares (P,) that came: over link `links` in run `runs`, of lane `lanes`; in order of run,
    receiver and sender."""

    runs: np.ndarray
    links: np.ndarray
    lanes: np.ndarray


def came_over(links: Links, shares: Shared, arriving: np.ndarray) -> Came:
    """Return the shares that arrive over links (R, E)."""
    lanes = np.zeros((len(arriving), links.nodes), dtype=np.int64)
    lanes[shares.runs, shares.nodes] = np.arange(len(shares.runs))
    runs, over = np.nonzero(arriving)
    return Came(runs, over, lanes[runs, links.sender[over]])


def as_sent(base: Gaussian, codec: BeliefCodec) -> tuple[Gaussian, np.ndarray]:
    """Return the decoded checkpoints of bases (L, n), and which can be read (L,)."""
    checkpoint = belief_of(codec.vector.received(belief_numbers(base)), codec.states)
    return checkpoint, finite_lanes(Gaussian(checkpoint.mean, cholesky(checkpoint.cov)))
