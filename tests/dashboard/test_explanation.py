"""The explanation of an estimate: the shares, slots, ages and weights that node and bus told."""

import re

import numpy as np
import pytest

from concord.dashboard.explain.explanation import explanation
from concord.dashboard.frames.provenance import STEPS_BACK, ShareArrival, provenance
from concord.dashboard.theme import DARK
from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.fusion.hold import held_weights, inverse_volume
from concord.filters.gaussian import Gaussian
from concord.nodes.vector_codec import BeliefCodec
from tests.dashboard.runs import run_of


def read_shares(stage, messages) -> dict[tuple[int, int], Gaussian]:
    """Beliefs in the frames of a run, by cycle and sender."""
    codec, form = BeliefCodec(len(stage.state_names)), stage.bus.frame_format
    shares = {}
    for topic, data in messages:
        if topic.startswith("share/"):
            fragment = form.read(data)
            body = form.join([fragment.data])
            shares[fragment.cycle, int(topic.partition("/")[2])] = codec.decode(body)
    return shares


def test_the_weights_of_a_step_make_its_estimate_of_its_shares():
    run = run_of("target-tracking", nodes=8, steps=12, graph="ring")
    frame = run.frames[-1]
    shares = read_shares(run.stage, run.messages)
    last = frame.cycles[-1].cycle
    for node in range(run.stage.nodes):
        made = provenance([frame], node)
        senders = [share.sender for share in made.shares]
        assert senders == run.stage.setup.neighbours[node]
        said = [shares[last, one] for one in (node, *senders)]
        beliefs = Gaussian(np.array([b.mean for b in said]), np.array([b.cov for b in said]))
        weights = np.array([made.own_weight, *(share.weight for share in made.shares)])
        # By the definition of the rule, from the frames alone.
        base, ages = np.array(run.stage.setup.weights[node]), np.zeros(len(said), dtype=int)
        volumes = inverse_volume(beliefs.cov)
        assert weights == pytest.approx(held_weights(base, ages, 0.5, volumes), abs=2e-4)
        fused = covariance_intersection(beliefs, weights / weights.sum())
        spread = np.sqrt(np.diagonal(fused.cov))
        assert np.abs(fused.mean - frame.belief.mean[node]).max() < 1e-2 * spread.max()


def test_each_share_is_found_where_it_was_on_the_bus():
    run = run_of(
        "target-tracking", nodes=8, steps=25, graph="ring", schedule="hybrid", occupancy=0.5,
        loss=0.3, changes=("5 kill 6", "9 cut 1 2"),
    )  # fmt: skip
    frames = run.frames
    met = set()
    for end in range(8, len(frames) + 1):
        past = frames[:end][-STEPS_BACK:]
        for node in np.flatnonzero(past[-1].alive):
            made = provenance(past, int(node))
            assert made.own_weight + sum(s.weight for s in made.shares) == pytest.approx(1)
            for share in made.shares:
                met.add(share.arrival)
                if share.age_cycles < 0:
                    assert share.arrival is ShareArrival.NEVER and share.weight == 0
                    continue
                assert share.step is not None and share.frames
                assert {one.node for one in share.frames} == {share.sender}
                sent = next(f for f in frames if f.step == share.step)
                cycle = next(c for c in sent.cycles if c.bus_cycle == share.bus_cycle)
                assert cycle.cycle + share.age_cycles == past[-1].cycles[-1].cycle
                assert (share.arrival is ShareArrival.FRESH) == (share.age_cycles == 0)
    assert met >= {
        ShareArrival.FRESH,
        ShareArrival.HELD,
        ShareArrival.LOST,
        ShareArrival.CUT,
        ShareArrival.DOWN,
    }


def test_a_rule_that_does_not_average_tells_no_weight_and_the_page_says_so():
    run = run_of("target-tracking", nodes=8, steps=4, rule="local")
    html = explanation(DARK, run.frames, 2)
    assert "The rule local tells no weights." in html
    assert "nan" not in html


def test_the_table_names_slot_age_and_weight_of_each_share():
    run = run_of("target-tracking", nodes=8, steps=6, graph="ring")
    frames = run.frames
    html = explanation(DARK, frames, 2)
    rows = dict(re.findall(r'<tr data-sender="(\d+)">(.*?)</tr>', html))
    assert sorted(map(int, rows)) == run.stage.setup.neighbours[2]
    for share in provenance(frames, 2).shares:
        cells = re.findall(r"<td[^>]*>(.*?)</td>", rows[str(share.sender)])
        frame = share.frames[0]
        assert cells[:3] == [run.stage.names[share.sender], f"{share.weight:.2f}", "0"]
        assert cells[3] == f"5, {share.bus_cycle}"
        assert cells[4].startswith(f"{frame.frame_id} (")
