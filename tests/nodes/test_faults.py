"""Compare each fault with a network that has the same effect for another reason."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import read_frame
from concord.bus.fragments import join
from concord.nodes import node as state_machine
from concord.nodes.changes import Fault, Standing
from concord.nodes.faults.vocabulary import COMMANDS, EVERY_FAULT, FAULTS
from concord.nodes.messages import Measured, ShareHeard
from concord.results.records.trace import Trace
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.setup import Setup
from tests.nodes.changing import messages, run, same_bits
from tests.nodes.fault_networks import FIRST, ROUNDS, STEPS, from_first, ring, total
from tests.nodes.networks import shuffled

ALONE = {"channel": "two channels are for a cluster of its own"}
# Nothing that a receiver uses is another than before.
HARMLESS = ("duplicate", "reorder", "spoof", "replay", "guardian", "slow-cpu")


@cache
def ring_run(*lines: str, **options) -> Trace:
    """Return the run of a ring in which this happens."""
    return run(ring(**options), *lines)


def rejected(trace: Trace) -> int:
    return sum(n for name, n in total(trace).items() if name.startswith("rejected"))


# --- all of them ---------------------------------------------------------------------------------


@pytest.mark.parametrize("word", COMMANDS)
def test_nothing_is_other_before_its_step(word: str):
    """Faults that have no command of their own are in the test below."""
    struck = ring_run(*from_first(COMMANDS[word].example))
    assert struck.mean[:FIRST].tobytes() == ring_run().mean[:FIRST].tobytes()


def test_nothing_is_other_if_all_faults_are_withdrawn_at_once():
    # The end of a partition heals each link, so it comes before the ends of single links.
    others = [word for word in EVERY_FAULT if word not in ("partition", "kill", *ALONE)]
    faults = [EVERY_FAULT[word] for word in ("partition", *others)]
    ended = [one for one in faults if one.withdrawal]
    lines = [line for one in ended for line in (one.example, one.withdrawal)]
    assert same_bits(ring_run(*from_first(*lines)), ring_run())
    calm = ring_run(*from_first(*(one.example for one in faults), "calm"))
    assert same_bits(calm, ring_run())
    assert total(calm) == total(ring_run())


@pytest.mark.parametrize("word", [word for word in FAULTS if word not in ALONE])
def test_only_what_should_be_harmless_is(word: str):
    fault = FAULTS[word]
    set_valued = [1.0 if number.name == "P" else 3.0 for number in fault.numbers]
    numbers = " ".join(f"{number:g}" for number in set_valued)
    node = {"link": "", "bus": "", "node": "1", "two nodes": "1 2"}[fault.place]
    lines = {"drift": "drift 1 9000", "guardian": "guardian 1"}
    line = lines.get(word, " ".join((word, *node.split(), numbers)))
    plain, struck = ring_run(), ring_run(*from_first(line))
    assert struck.mean[:FIRST].tobytes() == plain.mean[:FIRST].tobytes()
    assert same_bits(struck, plain) == (word in HARMLESS)
    # Nodes count all but what sensors deliver, and lies, which are well said; lockstep waits for a
    # slow processor.
    unseen = fault.family == "sensors" or word in ("lie", "guardian", "slow-cpu")
    assert (total(struck) == total(plain)) == unseen


SWARM = (
    "1 corrupt 0.1", "1 delay 0.2 2 1 2", "2 jitter 1 0 1 one-way", "2 duplicate 0.3",
    "2 reorder 0.4", "3 hang 3 2", "3 slow 0 1", "4 drift 2 700", "4 slow 0 0", "4 dropout 1 0.4",
    "5 missing 1 0.3", "5 crc 2 0.3", "5 null 0 0.3", "6 babble 3 0.2", "7 guardian 1",
    "7 spoof 0 1 0.5", "7 wrong-step 1 0.3 2", "7 replay 2 0.5 2", "8 nan 0 0.3",
    "8 indefinite 1 0.3", "8 lie 3 5 4", "8 outlier 1 0.5 20", "9 bias 2 3", "9 stuck 0 2",
    "9 partition 0 1", "10 heal", "10 kill 1", "11 calm", "11 restart 1", "13 corrupt 0.2",
    "14 set rule=hcmci rounds=2", "15 delay 0.5 1",
)  # fmt: skip


@settings(max_examples=2)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_of_arrival_does_not_matter_to_faults(seed: int):
    in_order = ring_run(*SWARM, steps=17, seed=7)
    other = run(ring(steps=17, seed=7), *SWARM, pick=shuffled(seed))
    assert same_bits(in_order, other)
    assert in_order.counters == other.counters


def test_seed_and_run_decide_whom_a_fault_strikes():
    lines = ("1 corrupt 0.3", "1 missing 1 0.3")
    once = total(run(ring(hold="drop"), *lines))
    assert once == total(run(ring(hold="drop"), *lines))
    for other in ({"seed": 2}, {"run": 1}):
        assert once != total(run(ring(hold="drop", **other), *lines))


# --- links ---------------------------------------------------------------------------------------


def test_a_frame_that_is_always_corrupt_is_a_link_that_is_cut():
    cut = ring_run(*from_first("cut 1 2 one-way"))
    corrupt = ring_run(*from_first("corrupt 1 1 2 one-way"))
    assert same_bits(corrupt, cut)
    reasons = {name for name, count in (total(corrupt) - total(cut)).items() if count}
    assert reasons <= {"rejected header-crc", "rejected frame-crc", "rejected length"}
    assert rejected(corrupt) == total(cut)["lost"] == (STEPS - FIRST) * ROUNDS


@pytest.mark.parametrize("cycles", [1, 2, 7])
def test_a_frame_that_is_late_is_not_used_and_counted_when_it_comes(cycles: int):
    cut = ring_run(*from_first("cut 1 2 one-way"))
    late = ring_run(*from_first(f"delay 1 {cycles} 1 2 one-way"))
    assert same_bits(late, cut)
    # The last ones come when the run is over.
    assert total(late)["late"] == (STEPS - FIRST) * ROUNDS - cycles
    assert same_bits(ring_run(*from_first(f"slow 1 {cycles}")), ring_run(*from_first(
        "cut 1 0 one-way", "cut 1 2 one-way"
    )))  # fmt: skip


def test_jitter_spreads_evenly_from_none_to_its_most():
    setup = ring(steps=30)
    frames = 8 * 30 * ROUNDS
    trace = run(setup, "0 jitter 3")
    in_time = total(trace)["heard"]
    # A binomial with p = 1/4; beyond four deviations once in 16000 seeds.
    assert abs(in_time - frames / 4) < 4 * np.sqrt(frames * 3 / 16)
    assert frames - in_time - 8 * 3 <= total(trace)["late"] <= frames - in_time


def test_a_share_that_comes_twice_is_used_once():
    plain, twice = ring_run(), ring_run("0 duplicate 1")
    assert same_bits(plain, twice)
    assert total(twice)["repeated"] == total(plain)["heard"]


@pytest.mark.parametrize("share", [{}, {"cluster": "audi", "loss": 0.2}, {"schedule": "dynamic"}])
def test_who_is_overtaken_is_used_all_the_same(share: dict):
    plain, mixed = ring_run(**share), ring_run("0 reorder 0.5", **share)
    assert same_bits(plain, mixed)
    assert total(mixed)["reordered"] > 20


def test_who_is_overtaken_waits_until_the_others_are_there():
    config = build_node(ring(), 1)
    standing = Standing(faults=(Fault("reorder", (0, 1), (1.0,)),))
    config = replace(config, faults=config.faults.stand(standing))
    state = state_machine.initial_state(config)
    state, _ = state_machine.step(config, state, Measured(1, 0, [[None]]))
    frames = {}
    for node in (0, 2):
        other = build_node(ring(), node)
        _, said = state_machine.step(
            other, state_machine.initial_state(other), Measured(node, 0, [[None]])
        )
        frames[node] = said[0].frame  # type: ignore[union-attr]
    state, _ = state_machine.step(config, state, ShareHeard(0, frames[0]))
    assert (0, 0) not in state.inbox.shares
    assert state_machine.awaited_neighbours(config, state) == [2]
    state, _ = state_machine.step(config, state, ShareHeard(2, frames[2]))
    assert state.cycle == 1
    assert state.counters == {"sent": 2, "reordered": 1, "heard": 2}


def test_a_partition_is_every_link_across_it_cut_and_heal_heals_all():
    apart = ("3 cut 1 2", "3 cut 0 4")
    assert same_bits(ring_run("3 partition 0 1", nodes=5), ring_run(*apart, nodes=5))
    assert same_bits(ring_run("3 partition 2 3 4", nodes=5), ring_run(*apart, nodes=5))
    healed = ring_run(*apart, "6 heal 1 2", "6 heal 0 4", nodes=5)
    assert same_bits(ring_run("3 partition 0 1", "6 heal", nodes=5), healed)


def test_what_is_said_of_one_link_comes_before_what_is_said_of_all():
    spared = ring_run("0 corrupt 1", "0 corrupt 0 1 2")
    others = ring_run("0 cut 0 1", "0 cut 2 3", "0 cut 3 0")
    assert same_bits(spared, others)


def test_calm_leaves_what_the_scenario_says_of_its_links():
    bad = ("2 loss 0.6", "2 loss 0.5 1 2", "2 cut 0 1")
    undone = ("5 loss 0.3", "5 loss 0.3 1 2", "5 heal 0 1")
    assert same_bits(ring_run(*bad, "5 calm", loss=0.3), ring_run(*bad, *undone, loss=0.3))


# --- nodes ---------------------------------------------------------------------------------------


def test_who_hangs_is_cut_off_and_reads_nothing_for_so_long():
    setup = ring()
    hung = run(setup, "3 hang 2 4")
    alone = run(
        setup, "3 partition 2", "3 dropout 2 1", "7 heal", "7 dropout 2 0"
    )  # fmt: skip
    assert same_bits(hung, alone)
    assert not hung.published[3:7, :, 2].any()
    assert hung.published[7:, :, 2].all()


def test_who_hangs_asks_for_no_slot():
    hung = ring_run("3 hang 5 4", nodes=6, schedule="hybrid", occupancy=0.5)
    assert not hung.asked[3:7, :, 5].any()
    assert hung.asked[:3, :, 5].any()


# --- sensors -------------------------------------------------------------------------------------


def spread(setup: Setup, node: int) -> float:
    """The standard deviation that a node of the oscillator believes its sensor has."""
    sensor = getattr(build_node(setup, node).estimator, "sensor", None)
    assert sensor is not None
    return float(np.sqrt(sensor.interpret(np.zeros(1))[1].item()))


def test_a_bias_is_added_to_every_reading():
    setup = ring()
    plain, biased = run(setup), run(setup, *from_first("bias 1 -5"))
    added = (biased.readings - plain.readings)[FIRST:, 1]
    np.testing.assert_allclose(added, -5 * spread(setup, 1), rtol=1e-12)
    kept = [0, 2, 3]
    np.testing.assert_array_equal(biased.readings[:, kept], plain.readings[:, kept])


def test_outliers_are_as_far_off_and_as_many_as_was_said():
    steps = 100
    setup = ring(steps=steps, rounds=1)
    plain, hit = run(setup), run(setup, "0 outlier 1 0.25 20")
    added = (hit.readings - plain.readings)[:, 1, 0, 0] / spread(setup, 1)
    far = np.abs(added) > 1
    np.testing.assert_allclose(np.abs(added[far]), 20, rtol=1e-9)
    assert abs(far.sum() - steps / 4) < 4 * np.sqrt(steps * 3 / 16)
    assert abs((added[far] > 0).sum() - far.sum() / 2) < 4 * np.sqrt(far.sum() / 4)


def test_a_stuck_sensor_repeats_itself_and_comes_free():
    plain, stuck = ring_run(), ring_run("3 stuck 1 4")
    assert (stuck.readings[3:7, 1] == plain.readings[2, 1]).all()
    np.testing.assert_array_equal(stuck.readings[7:, 1], plain.readings[7:, 1])


def test_a_step_without_reading_is_one_with_nan():
    setup = ring()
    dropped = run(setup, *from_first("dropout 1 1"))
    assert np.isnan(dropped.readings[FIRST:, 1]).all()
    assert not np.isnan(dropped.readings[:, 0]).any()


# --- the bus -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "counter"),
    [
        ("missing 2 1", None),
        ("crc 2 1", "rejected frame-crc"),
        ("null 2 1", "rejected null-frame"),
        ("wrong-step 2 1 2", "late"),
        ("nan 2 1", "rejected belief-not-finite"),
        ("indefinite 2 1", "rejected not-positive-definite"),
    ],
)
def test_whose_frames_are_of_no_use_is_as_if_it_were_not_heard(line: str, counter: str | None):
    struck = ring_run(*from_first(line))
    unheard = ring_run(*from_first("cut 2 1 one-way", "cut 2 3 one-way"))
    assert same_bits(struck, unheard)
    frames = (STEPS - FIRST) * ROUNDS
    if counter is not None:
        assert total(struck)[counter] == 2 * frames
    else:
        assert total(struck)["silent"] == frames
        assert not struck.published[FIRST:, :, 2].any()


def test_a_babbling_idiot_leaves_nobody_but_itself_unless_it_is_guarded():
    babbling = ring_run(*from_first("babble 3 1"))
    alone = [f"cut {i} {j} one-way" for i, j in ((0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (0, 3))]
    assert same_bits(babbling, ring_run(*from_first(*alone)))
    assert total(babbling)["rejected collision"] == 6 * (STEPS - FIRST) * ROUNDS
    assert same_bits(ring_run(*from_first("guardian 1", "babble 3 1")), ring_run())
    # A node that is out does not babble; a node that hangs does not babble while it hangs.
    assert same_bits(ring_run(*from_first("babble 3 1", "kill 3")), ring_run("3 kill 3"))
    assert same_bits(ring_run("3 babble 3 1", "3 hang 3 9"), ring_run("3 hang 3 9"))


@pytest.mark.parametrize("schedule", ["dynamic", "hybrid"])
def test_a_guardian_knows_the_owners_of_static_slots_alone(schedule: str):
    """Of a hybrid ring nodes 0 and 1 own static slots, and nodes 2 and 3 contend."""
    babbling = ring_run("0 babble 3 1", steps=20, schedule=schedule, occupancy=0.5)
    guarded = ring_run("0 guardian 1", "0 babble 3 1", steps=20, schedule=schedule, occupancy=0.5)
    calm = ring_run("0 guardian 1", steps=20, schedule=schedule, occupancy=0.5)
    owned = calm.published[..., :2].sum() if schedule == "hybrid" else 0
    lost = [total(trace)["rejected collision"] for trace in (babbling, guarded)]
    # Two neighbours hear each frame. The babbling node spoils no frame of its own.
    assert lost[0] == 2 * babbling.published[..., :3].sum()
    assert lost[1] == 2 * guarded.published[..., :3].sum() - 2 * owned > 0
    assert same_bits(babbling, guarded) == (schedule == "dynamic")


def test_a_frame_on_both_channels_is_lost_if_both_lose_it():
    redundant, few = ring(steps=40, cluster="fitted-ab"), ring(cluster="fitted-ab")
    plain = run(few)
    assert same_bits(plain, ring_run())
    assert same_bits(run(few, "0 channel A 1"), plain)
    assert same_bits(run(few, "0 channel B 1"), plain)
    assert total(run(few, "0 channel A 1", "0 channel B 1"))["heard"] == 0
    lost = total(run(redundant, "0 channel A 0.5", "0 channel B 0.4"))["lost"]
    # A channel loses a frame for both receivers at once.
    frames = 4 * 40 * ROUNDS
    assert lost % 2 == 0
    assert abs(lost / 2 - 0.2 * frames) < 4 * np.sqrt(frames * 0.16)


# --- malice --------------------------------------------------------------------------------------


def test_what_is_sent_in_the_name_of_others_or_again_is_counted_and_not_used():
    plain, frames = ring_run(), (STEPS - FIRST) * ROUNDS
    spoofed = ring_run(*from_first("spoof 2 0 1"))
    assert same_bits(spoofed, plain)
    assert total(spoofed)["rejected wrong-slot"] == 2 * frames
    replayed = ring_run(*from_first("replay 2 1 4"))
    assert same_bits(replayed, plain)
    assert total(replayed)["late"] == 2 * (frames - 4)


def test_a_liar_says_what_it_does_not_believe():
    setup = ring()
    honest, lying = recorded(setup), recorded(setup, *from_first("lie 2 -5 4"))
    codec = build_environment(setup).faults.equipment.codec
    assert codec is not None
    said = codec.decode(lying[FIRST * ROUNDS, 2])
    meant = codec.decode(honest[FIRST * ROUNDS, 2])
    np.testing.assert_allclose(said.cov * 4, meant.cov, rtol=1e-12)
    off = (said.mean - meant.mean) / np.sqrt(np.diagonal(meant.cov))
    np.testing.assert_allclose(off, -5, rtol=1e-9)
    assert lying[FIRST * ROUNDS - 1, 2] == honest[FIRST * ROUNDS - 1, 2]


def recorded(setup: Setup, *lines: str) -> dict[tuple[int, int], bytes]:
    """The body of what was sent, by cycle and node."""
    bodies = {}
    for topic, data in messages(setup, *lines):
        if topic.startswith("share/"):
            fragment = read_frame(data)
            bodies[fragment.cycle, int(topic.partition("/")[2])] = join([fragment.data])
    return bodies
