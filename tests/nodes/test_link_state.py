"""Loss by counting: the same for one frame and for arrays, at the rate that was asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.nodes.faults.losses import PERFECT, LinkState, Outage, hears, hears_all

WORD = st.integers(0, 2**64 - 1)
NODE = st.integers(0, 2**24 - 1)
STEP = st.integers(0, 40)
SOME_NODE = st.integers(0, 3)


@st.composite
def link_states(draw: st.DrawFn) -> LinkState:
    loss = st.floats(0, 1, exclude_max=True)
    outage = st.builds(Outage, SOME_NODE, SOME_NODE, STEP, st.none() | STEP)
    return LinkState(
        (draw(WORD), draw(WORD)),
        draw(loss),
        draw(st.dictionaries(st.tuples(SOME_NODE, SOME_NODE), loss, max_size=3)),
        tuple(draw(st.lists(outage, max_size=3))),
        draw(st.frozensets(st.tuples(SOME_NODE, SOME_NODE), max_size=2)),
        draw(st.sampled_from([None, lambda step, sender, receiver: (step + sender) % 3 != 0])),
    )


QUESTION = st.tuples(
    STEP, st.integers(0, 2**32 - 1), SOME_NODE | NODE, SOME_NODE | NODE, st.integers(0, 255)
)


@given(link_states(), st.lists(QUESTION, min_size=1, max_size=20))
def test_arrays_and_numbers_have_one_fate(links: LinkState, questions: list[tuple[int, ...]]):
    columns = np.array(questions).T
    alone = [hears(links, *question) for question in questions]
    assert hears_all(links, *columns).tolist() == alone
    # One question as arrays without a dimension, which numpy treats as scalars.
    assert bool(hears_all(links, *map(np.array, questions[0]))) == alone[0]


def splitmix64(state: int, count: int) -> list[int]:
    """A generator of 64-bit numbers as its authors print it."""
    numbers = []
    for _ in range(count):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        z = state
        z = ((z ^ (z // 2**30)) * 0xBF58476D1CE4E5B9) % 2**64
        z = ((z ^ (z // 2**27)) * 0x94D049BB133111EB) % 2**64
        numbers.append(z ^ (z // 2**31))
    return numbers


def test_the_hash_is_that_of_the_generator():
    """The first outputs for seed 1234567 are in the generator's public test vectors."""
    assert splitmix64(1234567, 2) == [6457827717110365317, 3203168211198807973]
    link, key = 5 * 2**40 + 6 * 2**16 + 7, (11, 12)
    (first,) = splitmix64(link ^ key[0], 1)
    (fate,) = splitmix64(first ^ 99 ^ key[1], 1)
    middle = fate / 2**64
    for loss, heard in ((middle - 1e-9, True), (middle + 1e-9, False)):
        assert hears(LinkState(key, loss), 0, 99, 5, 6, 7) == heard


@pytest.mark.parametrize("loss", [0.01, 0.1, 0.5, 0.9])
def test_the_rate_is_the_one_asked_for(loss: float):
    """Within five standard deviations for every link, every cycle and all together."""
    grid = np.meshgrid(np.arange(300), np.arange(20), np.arange(20), np.arange(3), indexing="ij")
    links = LinkState((123456789, 987654321), loss)
    lost = ~hears_all(links, grid[0], *grid)
    for axes in ((0, 1, 2, 3), (1, 2, 3), (0, 3), (0, 1, 2)):
        count = np.prod([lost.shape[axis] for axis in axes])
        spread = np.sqrt(loss * (1 - loss) / count)
        assert np.abs(lost.mean(axes) - loss).max() < 5 * spread


def test_fates_of_neighbouring_frames_are_not_alike():
    """No correlation between links there and back, cycles, frames and keys beyond chance."""
    cycles, pairs = np.meshgrid(np.arange(4000), np.arange(25), indexing="ij")
    senders, receivers = pairs // 5, 10 + pairs % 5

    def lost(key: int, cycle, sender, receiver, frame: int) -> np.ndarray:
        return ~hears_all(LinkState((key, 0), 0.5), cycle, cycle, sender, receiver, frame)

    fate = lost(1, cycles, senders, receivers, 0)
    for other in (
        lost(1, cycles, receivers, senders, 0),
        lost(1, cycles + 1, senders, receivers, 0),
        lost(1, cycles, senders, receivers, 1),
        lost(2, cycles, senders, receivers, 0),
    ):
        assert abs(np.corrcoef(fate.ravel(), other.ravel())[0, 1]) < 5 / np.sqrt(fate.size)


def test_a_cut_link_is_cut_one_way_and_for_its_time():
    links = LinkState(outages=(Outage(1, 2, 3, 5), Outage(2, 3, 4)))
    assert [hears(links, step, 0, 1, 2) for step in range(7)] == [1, 1, 1, 0, 0, 1, 1]
    assert all(hears(links, step, 0, 2, 1) for step in range(7))
    assert [hears(links, step, 0, 2, 3) for step in range(7)] == [1, 1, 1, 1, 0, 0, 0]
    assert not links.perfect
    assert PERFECT.perfect


def test_a_link_may_have_a_loss_of_its_own():
    cycles = np.arange(2000)
    links = LinkState((5, 6), 0.0, {(0, 1): 0.5})
    assert hears_all(links, cycles, cycles, cycles * 0 + 1, cycles * 0).all()
    lost = ~hears_all(links, cycles, cycles, cycles * 0, cycles * 0 + 1)
    assert 0.4 < lost.mean() < 0.6
