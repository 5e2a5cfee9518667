"""The figures of many runs are, run by run, those of `concord run`."""

import numpy as np
import pytest

from concord.results.figures.figure_table import FIGURES, SWEPT, computed
from concord.results.figures.run_frame import frame_of
from concord.results.figures.run_view import RunView
from concord.results.figures.summary import summarise
from concord.results.figures.traffic import energy_per_bit_nj
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.scenario_options import scenario_of
from concord.studies.monte_carlo.convergence import settling_interval, settling_steps
from concord.studies.monte_carlo.pareto import front
from concord.studies.monte_carlo.simulate import AGES, INNOVATIONS, READINGS, simulate
from tests.experiments.support import summary_of

CHANGES = ("3 kill 1", "10 loss 0.3", "12 restart 1", "14 kill 2")
CASES = [
    ("target-tracking", {"nodes": 8, "steps": 25, "occupancy": 0.5}),
    ("target-tracking", {"nodes": 8, "steps": 25, "bus": "ideal", "graph": "ring"}),
    ("oscillator", {"nodes": 4, "steps": 24, "rule": "hcmci"}),
    ("dc-motor-speed", {"nodes": 4, "steps": 62}),
    ("oscillator", {"nodes": 5, "steps": 30, "changes": CHANGES}),
    ("oscillator", {"nodes": 5, "steps": 30, "changes": (*CHANGES, "18 set rounds=1")}),
]


@pytest.mark.parametrize(("name", "fields"), CASES)
def test_a_run_many_runs_and_a_sweep_have_equal_figures_under_equal_names(name: str, fields: dict):
    setup = prepare(scenario_of(name, **fields))
    runs = range(3, 5)
    # Sweeps keep innovations of logs alone.
    histories = simulate(setup, runs, keep=(READINGS, AGES, INNOVATIONS))
    swept = computed(RunView(histories, frame_of(histories)))
    assert set(swept) == set(SWEPT)
    for place, run in enumerate(runs):
        one = setup_of_run(setup, run)
        single = summary_of(one, read_trace(one, in_memory(one)))
        of_many = summarise(histories.of(slice(place, place + 1)))
        assert single.figures.keys() == of_many.figures.keys()
        for figure, interval in single.figures.items():
            value = pytest.approx(interval.value, rel=1e-9, abs=1e-12, nan_ok=True)
            assert of_many.value(figure) == value, figure
            if figure in swept:
                assert swept[figure][place] == value, figure
        of_nodes = [node["rmse"].value for node in single.nodes]
        np.testing.assert_allclose(swept["rmse_node"][place], of_nodes)


def test_the_figures_of_the_bus_are_those_of_its_report():
    """Computed by counting the frames cycle by cycle."""
    setup = prepare(scenario_of("target-tracking", nodes=8, steps=25, occupancy=0.5))
    found = summary_of(setup, read_trace(setup, in_memory(setup)))
    bus, ages = found.details["bus"], np.array(found.details["bus"].share_ages)
    expected = {
        **{name: getattr(bus, name) for name in ("bus_load", "delay_us", "bytes_per_step")},
        "share_age": (ages * np.arange(len(ages))).sum() / ages.sum(),
        "share_age_max": len(ages) - 1,
    }
    assert {name: found.value(name) for name in expected} == pytest.approx(expected)


def test_who_publishes_is_counted_in_the_cycles_that_there_were():
    """Four nodes that always do, one for half of the time; in steps of three rounds and of one."""
    changes = ("5 kill 0", "5 set rounds=1")
    setup = prepare(scenario_of("oscillator", nodes=5, steps=10, changes=changes))
    histories = simulate(setup, range(2))
    figures = computed(RunView(histories, frame_of(histories)))
    assert figures["published"].tolist() == pytest.approx([(5 * 15 + 4 * 5) / (5 * 20)] * 2)
    assert np.isnan(figures["bus_load"]).all()


def test_shapes_are_those_that_are_promised():
    setup = prepare(scenario_of("oscillator", nodes=3, steps=22))
    histories = simulate(setup, range(2))
    sizes = {"run": 2, "step": 22, "node": 3, "state": 2}
    for name, values in computed(RunView(histories, frame_of(histories))).items():
        assert values.shape == tuple(sizes[d] for d in FIGURES[name].dimensions), name


def test_the_frame_is_computed_once_for_equal_noise_and_anew_for_other():
    first = prepare(scenario_of("oscillator", nodes=3, steps=5))
    other = prepare(scenario_of("oscillator", nodes=3, steps=5, rule="wac"))
    seeded = prepare(scenario_of("oscillator", nodes=3, steps=5, seed=9))
    one, two, three = (frame_of(simulate(s, range(1))) for s in (first, other, seeded))
    assert one is two
    assert one is not three


def test_bytes_count_what_frames_add():
    # So wide a share that it takes two frames.
    network = {"nodes": 4, "graph": "ring", "schedule": "full"}
    setup = prepare(
        scenario_of("target-tracking", steps=3, rule="hcmci", number="float64", **network)
    )
    frames = [data for topic, data in in_memory(setup) if topic.startswith("share/")]
    assert len(frames) == 3 * 3 * 4 * 2
    histories = simulate(setup, range(1))
    figures = computed(RunView(histories, frame_of(histories)))
    assert figures["bytes_per_step"].tolist() == [sum(map(len, frames)) / 3]


def test_energy_grows_with_the_square_of_the_reach():
    positions = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 300.0]])
    nanojoules = energy_per_bit_nj([[1, 2], [0], [0]], positions)
    assert nanojoules.tolist() == pytest.approx(
        [50 * 3 + 0.1 * 300**2, 50 * 2 + 0.1 * 100**2, 50 * 2 + 0.1 * 300**2]
    )


def falling(runs: int, steps: int, settled_at: int) -> np.ndarray:
    error = np.where(np.arange(steps) < settled_at, 10.0, 1.0)
    return error * (1 + 0.05 * np.random.default_rng(0).standard_normal((runs, steps)))


@pytest.mark.parametrize("settled_at", [0, 7, 20])
def test_settling_is_the_last_step_that_is_off(settled_at: int):
    error = falling(20, 60, settled_at)
    assert settling_steps(error, 0) == settled_at
    assert settling_steps(error, 5) == max(settled_at - 5, 0)
    interval = settling_interval(error, 0)
    assert interval.low <= settled_at <= interval.high


def test_what_is_off_until_the_end_never_settles():
    assert np.isnan(settling_steps(falling(5, 60, 45), 0))
    assert np.isnan(settling_steps(falling(5, 60, 10), 59))


def test_the_front_is_what_nothing_beats():
    cost = np.array([1.0, 2.0, 2.0, 3.0, np.nan, 4.0, 1.0])
    error = np.array([5.0, 4.0, 3.0, 3.5, 0.0, 1.0, 6.0])
    assert front(cost, error).tolist() == [0, 2, 5]


@pytest.mark.parametrize("fields", [{"schedule": "full"}, {"schedule": "hybrid", "occupancy": 0.5}])
def test_figures_of_a_run_do_not_depend_on_the_runs_beside_it(fields: dict):
    """Runs share what is computed once where their traffic is the same."""
    setup = prepare(scenario_of("target-tracking", nodes=6, steps=25, **fields))
    histories = simulate(setup, range(3))
    together = computed(RunView(histories, frame_of(histories)))
    contended = not (histories.classes == histories.classes[:1]).all()
    assert contended == (fields["schedule"] == "hybrid")
    for run in range(3):
        own = simulate(setup, [run])
        alone = computed(RunView(own, frame_of(own)))
        for name, values in alone.items():
            if "run" in FIGURES[name].dimensions:
                np.testing.assert_allclose(
                    together[name][run], values[0], rtol=1e-9, equal_nan=True, err_msg=name
                )
