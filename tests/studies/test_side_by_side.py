"""Runs in threads: the same bits for any number of threads, errors and Ctrl-C told as in one."""

import numpy as np
import pytest

from concord.experiments.scenario_flags import scenario_of
from concord.scenarios.preparation import prepare
from concord.studies.monte_carlo.side_by_side import side_by_side
from concord.studies.monte_carlo.simulate import OPTIONAL, Interrupted, simulate

RUNS = 120


def arrays(runs) -> dict[str, np.ndarray]:
    values = {**runs._asdict(), **runs.counters}
    values |= {} if runs.innovations is None else runs.innovations._asdict()
    return {name: one for name, one in values.items() if isinstance(one, np.ndarray)}


@pytest.mark.parametrize("rule", ["sharp-ci", "labelled"])
def test_the_number_of_threads_changes_no_bit(rule):
    setup = prepare(scenario_of("oscillator", nodes=10, steps=6, rule=rule))
    one, *others = (
        arrays(simulate(setup, range(RUNS), keep=OPTIONAL, threads=count)) for count in (1, 2, 5)
    )
    assert len(one) > 10
    for other in others:
        assert other.keys() == one.keys()
        for name, values in one.items():
            assert np.array_equal(values, other[name], equal_nan=values.dtype.kind == "f"), name


def test_parts_come_in_order_and_an_error_ends_the_others():
    parts = [slice(place, place + 1) for place in range(6)]

    def work(part, go_on):
        if part.start == 3:
            raise ValueError("the fourth")
        while part.start > 3:
            go_on()

    done = []
    with pytest.raises(ValueError, match="the fourth"):
        done.extend(part.start for part in side_by_side(work, parts, threads=4))
    assert done == [] or done == [0, 1, 2]


@pytest.mark.parametrize("threads", [1, 3])
def test_an_interrupt_keeps_the_parts_that_are_complete(threads, monkeypatch):
    monkeypatch.setattr("concord.studies.monte_carlo.simulate.LANES", 40)
    setup = prepare(scenario_of("oscillator", nodes=4, steps=5))
    whole = simulate(setup, range(40))

    def interrupt(done: int) -> None:
        if done > 5 * 30:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        simulate(setup, range(40), on_progress=interrupt, threads=threads)
    kept = stopped.value.runs
    if kept is None:
        assert threads > 1, "one thread completes the first part before it begins the last"
    else:
        assert 0 < len(kept.runs) < 40
        assert np.array_equal(kept.mean, whole.mean[: len(kept.runs)])
