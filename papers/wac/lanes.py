"""A network as one array program over many runs: what the tables of many runs are counted with.

The nodes of `nodes/` are the reference; the tests hold this against them, run by run. It serves the
rules whose rounds are averages (wac, ci, hcmci, icf), with one reading per node, on a bus that
loses no frame. A sender's last share is then the same at all its receivers, and is kept once.

`simulate`, the driver for scenarios, would not do here for two reasons. The
study gives a slot to any share, however many FlexRay frames it takes, and a scenario is refused
where its bus cannot hold that. And one set of runs is drawn and put through every rule, policy and
occupancy, where a scenario draws and drives the plant for itself.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from bus.schedule import Schedule
from filters.fusion import hybrid_consensus, information_weighted
from filters.fusion.hold import sharpness
from filters.fusion.packed import pack, unpack
from filters.gaussian import Gaussian, Information, to_gaussian, to_information
from filters.linalg import symmetrise
from filters.sigma_points import scaled_unscented
from filters.ukf import predict, update
from nodes.bids import BID_RESOLUTION, FIRST_BID
from nodes.rules.belief_consensus import HoldPolicy
from papers.wac.runs import Runs


class Averaging(NamedTuple):
    """A rule: what it averages, as numbers (..., N, m), and the belief that an average comes to.

    `holds` says that old numbers have a meaning, those of the belief that was then published.
    """

    express: Callable[[Gaussian, Gaussian], np.ndarray]
    conclude: Callable[[np.ndarray], Gaussian]
    holds: bool


class Wiring(NamedTuple):
    """Neighbours of each node, their weights, the schedule, and the hold policy.

    heard: (N, J), each node first and then its neighbours, filled up with itself; weights: (N, J),
    zero where filled up.
    """

    heard: np.ndarray
    weights: np.ndarray
    rounds: int
    schedule: Schedule
    policy: HoldPolicy


class _State(NamedTuple):
    """Every node of every run. `held` is what was last heard of each node, `published` its belief
    then, `ages` (R, N) the cycles since, negative for never."""

    belief: Gaussian
    numbers: np.ndarray
    held: np.ndarray
    published: Gaussian
    ages: np.ndarray


def averaging_of(rule: str, nodes: int, states: int) -> Averaging:
    """The rule of that name in a network of `nodes`, for a plant of `states`."""
    alone = np.eye(nodes)
    rules = {
        "wac": Averaging(
            lambda _, belief: pack(Information(*belief)),
            lambda numbers: Gaussian(*unpack(numbers)),
            holds=True,
        ),
        "ci": Averaging(
            lambda _, belief: pack(to_information(belief)),
            lambda numbers: to_gaussian(unpack(numbers)),
            holds=True,
        ),
        "hcmci": Averaging(
            partial(hybrid_consensus.begin, row=alone),
            partial(hybrid_consensus.conclude, states=states, gain=hybrid_consensus.safe_gain),
            holds=False,
        ),
        "icf": Averaging(
            partial(information_weighted.begin, nodes=nodes),
            partial(information_weighted.conclude, nodes=nodes),
            holds=False,
        ),
    }
    return rules[rule]


def wire(weights: np.ndarray, rounds: int, schedule: Schedule, policy: HoldPolicy) -> Wiring:
    """The wiring of a weight matrix (N, N)."""
    nodes = len(weights)
    links = [np.flatnonzero(row) for row in np.where(np.eye(nodes, dtype=bool), 0.0, weights)]
    width = 1 + max(len(others) for others in links)
    heard = np.tile(np.arange(nodes)[:, None], (1, width))
    weighed = np.zeros((nodes, width))
    weighed[:, 0] = weights.diagonal()
    for node, others in enumerate(links):
        heard[node, 1 : 1 + len(others)] = others
        weighed[node, 1 : 1 + len(others)] = weights[node, others]
    return Wiring(heard, weighed, rounds, schedule, policy)


def estimate(runs: Runs, wiring: Wiring, averaging: Averaging) -> Gaussian:
    """Beliefs of all nodes after the last round of each step: (steps, R, N, n), (..., n, n)."""
    steps, count, nodes = runs.readings.shape[:3]
    n = runs.prior.mean.shape[-1]
    prior = _spread(runs.prior, (count, nodes))
    numbers = averaging.express(prior, prior)
    state = _State(prior, numbers, numbers, prior, np.full((count, nodes), -1))
    means, covs = np.empty((steps, count, nodes, n)), np.empty((steps, count, nodes, n, n))
    for step in range(steps):
        if step > 0:
            state = _carry(state, runs, wiring, averaging, step)
        taken = _take(state.belief, runs, step)
        numbers = averaging.express(state.belief, taken)
        state = state._replace(belief=taken, numbers=numbers)
        for turn in range(wiring.rounds):
            senders = _senders(state, wiring.schedule, step * wiring.rounds + turn)
            state = _fuse(_publish(state, senders), wiring, averaging, turn)
        means[step], covs[step] = state.belief
    return Gaussian(means, covs)


def centralised(runs: Runs) -> Gaussian:
    """The filter that takes all readings of a step at once: (steps, R, n), (steps, R, n, n)."""
    steps, count, nodes, d = runs.readings.shape
    points = scaled_unscented(runs.prior.mean.shape[-1])
    belief = _spread(runs.prior, (count,))
    _, noise_cov = runs.sensors.interpret(runs.readings[0])
    together = _block_diagonal(noise_cov)

    def residual(value: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        left, right = (array.reshape(*array.shape[:-1], nodes, d) for array in (value, predicted))
        difference = runs.sensors.residual(left, right)
        return difference.reshape(*difference.shape[:-2], nodes * d)

    means, covs = [], []
    for step in range(steps):
        if step > 0:
            belief = _kept(belief, _predicted(belief, runs, step, ()))

        def measure(points: np.ndarray, step: int = step) -> np.ndarray:
            seen = runs.sensors.measure(points[..., None, :], step)
            return seen.reshape(*seen.shape[:-2], nodes * d)

        delivered = runs.readings[step].reshape(count, nodes * d)
        result = update(belief, delivered, measure, together, points, residual=residual)
        belief = _kept(belief, result.belief)
        means.append(belief.mean)
        covs.append(belief.cov)
    return Gaussian(np.array(means), np.array(covs))


def _spread(prior: Gaussian, lanes: tuple[int, ...]) -> Gaussian:
    """One prior mean per run (R, n) for all of its nodes."""
    n = prior.mean.shape[-1]
    mean = prior.mean.reshape(len(prior.mean), *(1,) * (len(lanes) - 1), n)
    return Gaussian(
        np.broadcast_to(mean, (*lanes, n)).copy(), np.broadcast_to(prior.cov, (*lanes, n, n)).copy()
    )


def _carry(state: _State, runs: Runs, wiring: Wiring, averaging: Averaging, step: int) -> _State:
    """All beliefs one step on; with them what is held, where the policy or the bids want it."""
    everybody = len(wiring.schedule.static_senders(step * wiring.rounds)) == wiring.schedule.nodes
    if everybody or (averaging.holds and not wiring.policy.carried):
        moved = _predicted(state.belief, runs, step, (1,))
        return state._replace(belief=_kept(state.belief, moved))
    both = Gaussian(
        np.stack([state.belief.mean, state.published.mean]),
        np.stack([state.belief.cov, state.published.cov]),
    )
    moved = _predicted(both, runs, step, (1,))
    sound = _finite(moved)[1]
    moved = _kept(both, moved)
    published = Gaussian(moved.mean[1], moved.cov[1])
    return state._replace(
        belief=Gaussian(moved.mean[0], moved.cov[0]),
        published=published,
        held=averaging.express(published, published) if averaging.holds else state.held,
        ages=np.where(sound, state.ages, -1),
    )


def _predicted(belief: Gaussian, runs: Runs, step: int, nodes: tuple[int, ...]) -> Gaussian:
    """Beliefs (..., R, *nodes, n) of the step before, at this one; control is one per run."""
    control = None
    if runs.controls is not None:
        before = runs.controls[step - 1]
        control = before.reshape(len(before), *nodes, -1)
    transition = partial(runs.model.transition, control=control, step=step - 1)
    points = scaled_unscented(belief.mean.shape[-1])
    return predict(belief, transition, runs.model.process_noise_cov(step - 1), points)


def _take(belief: Gaussian, runs: Runs, step: int) -> Gaussian:
    """Beliefs (R, N, n) after each node's own reading."""
    value, noise_cov = runs.sensors.interpret(runs.readings[step])
    measure = partial(runs.sensors.measure, step=step)
    points = scaled_unscented(belief.mean.shape[-1])
    residual = runs.sensors.residual
    result = update(belief, value, measure, noise_cov, points, residual=residual)
    return _kept(belief, result.belief)


def _senders(state: _State, schedule: Schedule, cycle: int) -> np.ndarray:
    """Return the publishers, (R, N): owners of static slots and the most urgent contenders."""
    sends = np.zeros(state.ages.shape, dtype=bool)
    sends[:, list(schedule.static_senders(cycle))] = True
    contenders = np.array(schedule.contenders(cycle), dtype=int)
    if not len(contenders):
        return sends
    change = (state.belief.mean - state.published.mean)[:, contenders]
    cov = state.belief.cov[:, contenders]
    squared = np.vecdot(change, np.linalg.solve(cov, change[..., None])[..., 0])
    bids = np.minimum(np.maximum(squared, 0.0) // BID_RESOLUTION, FIRST_BID - 1)
    bids = np.where(state.ages[:, contenders] < 0, FIRST_BID, bids)
    # Stable: a tie goes to the lower node, whose frame ID is lower.
    first = np.argsort(-bids, axis=1, kind="stable")[:, : schedule.dynamic_slots(cycle)]
    np.put_along_axis(sends, contenders[first], True, axis=1)
    return sends


def _publish(state: _State, senders: np.ndarray) -> _State:
    """Return the held shares of all nodes after a cycle in which `senders` (R, N) published."""
    mean = np.where(senders[..., None], state.belief.mean, state.published.mean)
    cov = np.where(senders[..., None, None], state.belief.cov, state.published.cov)
    older = np.where(state.ages < 0, -1, state.ages + 1)
    return state._replace(
        published=Gaussian(mean, cov),
        held=np.where(senders[..., None], state.numbers, state.held),
        ages=np.where(senders, 0, older),
    )


def _fuse(state: _State, wiring: Wiring, averaging: Averaging, turn: int) -> _State:
    """One round at every node."""
    ages, covs = state.ages[:, wiring.heard], state.published.cov[:, wiring.heard]
    ages[..., 0], covs[:, :, 0] = 0, state.belief.cov
    sharp = sharpness(covs) if wiring.policy.by_sharpness else np.ones(covs.shape[:-2])
    weights = wiring.policy.weigh(wiring.weights, ages, sharp, turn)
    others = np.zeros((*state.ages.shape, state.ages.shape[1]))
    # Filled-up places have weight zero and point at the node itself, whose entry is not used.
    places = np.broadcast_to(wiring.heard, weights.shape)[..., 1:]
    np.put_along_axis(others, places, weights[..., 1:], axis=-1)
    numbers = weights[..., :1] * state.numbers + others @ state.held
    belief = averaging.conclude(numbers)
    sound = _finite(belief)
    belief = Gaussian(belief.mean, symmetrise(belief.cov))
    return state._replace(
        belief=_kept(state.belief, belief),
        numbers=np.where(sound[..., None], numbers, state.numbers),
    )


def _kept(before: Gaussian, after: Gaussian) -> Gaussian:
    """The belief after, but the one before in lanes where something failed."""
    sound = _finite(after)
    if sound.all():
        return after
    return Gaussian(
        np.where(sound[..., None], after.mean, before.mean),
        np.where(sound[..., None, None], after.cov, before.cov),
    )


def _finite(belief: Gaussian) -> np.ndarray:
    mean = np.isfinite(belief.mean).all(axis=-1)
    return np.logical_and(mean, np.isfinite(belief.cov).all(axis=(-1, -2)))


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """(R, N, d, d) as (R, N d, N d)."""
    count, nodes, d, _ = blocks.shape
    joined = np.zeros((count, nodes, d, nodes, d))
    for node in range(nodes):
        joined[:, node, :, node, :] = blocks[:, node]
    return joined.reshape(count, nodes * d, nodes * d)
