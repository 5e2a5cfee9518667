"""Messages that a network can have said, and the links that carry its frames."""

import pytest

from concord.nodes.bounds import MAX_ROUNDS
from concord.nodes.messages import Estimate, Truth
from concord.runtime.drivers import in_memory
from concord.runtime.in_process import run
from concord.runtime.recorded import fits, message_of
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from tests.experiments.support import small

SETUP = small(nodes=3, steps=4)
N = len(SETUP.prior_mean)
SOUND = Estimate(1, 2, [0.0] * N, [None] * (N * (N + 1) // 2), [-1, 0], {})


@pytest.mark.parametrize("number", range(4))
def test_a_truth_has_the_states_of_the_plant(number: int):
    assert fits(Truth(0, [0.0] * number), SETUP) == (number == len(SETUP.initial_state))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, True),
        ({"ages": [-1, 3 * MAX_ROUNDS]}, True),
        ({"ages": [0, 3 * MAX_ROUNDS + 1]}, False),
        ({"ages": [-2, 0]}, False),
        ({"ages": [0] * 3}, True),
        ({"ages": [0] * 4}, False),
        ({"mean": [0.0] * (N + 1)}, False),
        ({"cov": [0.0] * (N * N)}, False),
    ],
)
def test_an_estimate_has_the_sizes_of_a_belief_and_ages_of_its_step(change: dict, expected: bool):
    fields = {name: getattr(SOUND, name) for name in SOUND.__struct_fields__} | change
    assert fits(Estimate(**fields), SETUP) is expected


def test_bytes_on_no_topic_of_the_network_mean_nothing():
    words = b'{"step":0,"state":[0.0]}'
    assert message_of("truth", words, 3) == Truth(0, [0.0])
    for topic in ("truth/0", "truths", "estimate/0", "estimate/3", "share/0", ""):
        assert message_of(topic, words, 3) is None


def test_each_receiver_has_a_link_of_its_own():
    asked: set[tuple[int, int]] = set()

    def link(sender: int, receiver: int, frame: bytes) -> list[bytes]:
        asked.add((sender, receiver))
        return [frame]

    setup, recorder = small(nodes=5, steps=2, graph="star"), MemoryRecorder()
    nodes = [build_node(setup, node) for node in range(5)]
    run(build_environment(setup), nodes, recorder, link=link)
    expected = {(j, i) for i, heard in enumerate(setup.neighbours) for j in heard}
    assert asked == expected
    assert recorder.messages == in_memory(setup)
