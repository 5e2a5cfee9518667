"""Loss on arrival equals loss on the way, and a neighbour may run far ahead."""

from collections.abc import Iterable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import read_frame
from concord.bus.schedule import round_robin
from concord.nodes.faults.losses import LinkState, Outage, hears
from concord.runtime.in_process import first_come
from tests.nodes.networks import (
    PREDICT,
    SEEDS,
    Network,
    last_come,
    network,
    networks,
    random_cov,
    random_priors,
    ring,
    run,
    shuffled,
    with_links,
)


@given(networks(), st.floats(0, 0.9), SEEDS, SEEDS)
@settings(max_examples=15)
def test_what_a_link_loses_is_as_if_it_had_never_come(
    net: Network, loss: float, fate: int, order: int
):
    """Marked as lost on arrival, or dropped on the way until the time of a cycle is over."""
    links = LinkState((fate, order), loss, outages=(Outage(0, 1, 1, 3),))
    marked = with_links(net, links)

    def dropping(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        cycle = read_frame(frame).cycle
        arrives = hears(links, cycle // net.environment.rounds, cycle, sender, receiver)
        return (frame,) if arrives else ()

    dropped = run(net, dropping)
    for pick in (first_come, shuffled(order), last_come):
        outcome = run(marked, pick=pick)
        assert outcome.same_bits(dropped)
        assert outcome.counted("missed") == dropped.counted("missed")
        assert outcome.counted("lost") == outcome.counted("missed")
        assert outcome.counted("late") == 0


def test_a_neighbour_may_run_far_ahead_without_loss():
    """Node 0 is served last: by then its neighbour has run as far ahead as turns allow."""
    count, rounds = 50, 40
    generator = np.random.default_rng(0)
    net = network(
        ring(count),
        random_priors(generator, count, 1),
        steps=2,
        rounds=rounds,
        schedule=round_robin(count, 1),
        hold_policy=PREDICT,
        process_noise_cov=random_cov(generator, 1),
    )
    newest_first = run(net, pick=last_come)
    assert newest_first.counted("missed") == 0
    assert newest_first.counted("rejected future") == 0
    assert newest_first.same_bits(run(net))
