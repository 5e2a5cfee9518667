"""Records of forged messages: a value anywhere in them is replaced, and readers go on."""

import random
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.dashboard.frames.source import assembled
from concord.dashboard.frames.stage import set_stage
from concord.results.bus.bus_capture import capture
from concord.results.figures.summary import heard_by_all, summarise
from concord.results.records.runs import runs_of_trace
from concord.results.records.runs_file import runs_arrays
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from tests.experiments.support import small

STEPS = 5
SETUPS = {
    "full": small(steps=STEPS),
    "contended": small(steps=STEPS, schedule="hybrid", occupancy=0.5),
    "labelled": small(steps=STEPS, rule="labelled", schedule="dynamic", occupancy=0.25),
    "can-fd": small(steps=STEPS, bus="can-fd", schedule="dynamic", occupancy=0.5),
}
MESSAGES = {name: in_memory(setup) for name, setup in SETUPS.items()}
_VALUES = (0, -1, 1, 2, 300, 1 << 31, (1 << 32) - 1, 1e308, -1e308, 1e-308, 1e16, None)
_OTHERS = ([], True, "x", {}, [1.0], [None])


def forged(said: Any, draw: random.Random) -> Any:
    """Return a message with another value somewhere in it."""
    if not isinstance(said, dict | list) or not said:
        return draw.choice((*_VALUES, *_OTHERS))
    copy = said.copy()
    place = draw.choice(list(said)) if isinstance(said, dict) else draw.randrange(len(said))
    copy[place] = forged(said[place], draw) if draw.random() < 0.7 else draw.choice(_VALUES)
    return copy


def check_readers(name: str, messages: list[tuple[str, bytes]]) -> None:
    setup = SETUPS[name]
    frames = list(assembled(set_stage(setup), messages))
    assert len({frame.step for frame in frames}) == len(frames) <= STEPS
    trace = read_trace(setup, messages)
    if not trace.steps:
        return
    capture(setup, trace, messages)
    runs = runs_of_trace(setup, trace)
    heard = heard_by_all(runs)
    assert runs_arrays(runs, heard=heard).variables["mean"][1].shape[1] == trace.steps <= STEPS
    assert summarise(runs, heard=heard).steps == trace.steps
    assert (np.asarray(trace.ages) >= -1).all()


@pytest.mark.parametrize("name", SETUPS)
@given(st.integers(0, 1 << 32), st.sampled_from((1, 3, 10)))
@settings(max_examples=20)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_forged_values_end_no_reader(name: str, seed: int, number: int):
    draw, messages = random.Random(seed), list(MESSAGES[name])
    for _ in range(number):
        place = draw.randrange(len(messages))
        topic, data = messages[place]
        if not topic.startswith("share"):
            words = msgspec.json.encode(forged(msgspec.json.decode(data), draw))
            messages[place : place + draw.randrange(2)] = [(topic, words)]
    check_readers(name, messages)


FORGERIES = [
    ("truth", {"state": []}),
    ("measured", {"readings": []}),
    ("measured", {"readings": [[1.0, 2.0, 3.0]]}),
    ("estimate", {"cov": []}),
    ("estimate", {"mean": [1.0]}),
    ("estimate", {"ages": [1 << 40]}),
    ("estimate", {"ages": [-2]}),
    ("estimate", {"counters": {str(number): 1 for number in range(5000)}}),
    ("grant", {"classes": [300] * 4}),
    ("grant", {"winners": [0, 1, 2, 3]}),
    ("grant", {"cut": [{"node": 0, "frames": 1, "urgency_class": (1 << 32) - 1}]}),
    ("grant", {"cut": [{"node": 0, "frames": 1, "urgency_class": (1 << 16) - 1}]}),
]


@pytest.mark.parametrize("name", SETUPS)
@pytest.mark.parametrize(("kind", "forgery"), FORGERIES)
def test_a_forged_field_ends_no_reader(name: str, kind: str, forgery: dict[str, Any]):
    """It comes before the true message, after it, and in its place."""
    of_kind = [place for place, one in enumerate(MESSAGES[name]) if one[0].startswith(kind)]
    for way in range(3) if of_kind else ():
        messages = list(MESSAGES[name])
        for place in reversed(of_kind[4:9]):
            topic, data = messages[place]
            words = (topic, msgspec.json.encode(msgspec.json.decode(data) | forgery))
            beside = [words, messages[place]], [messages[place], words], [words]
            messages[place : place + 1] = beside[way]
        check_readers(name, messages)
