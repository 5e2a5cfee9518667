"""Records of several runs: in a data set and back, joined from parts, and as errors of the past."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from concord.results.figures.run_frame import without_bound
from concord.results.figures.run_view import RunView
from concord.results.figures.smoothed_errors import lagged, shown_lags, smoothed_errors
from concord.results.figures.summary import summarise
from concord.results.outages import outages_of
from concord.results.records.netcdf_file import write_dataset
from concord.results.records.runs import Runs, joined, runs_of_trace
from concord.results.records.runs_file import read_runs, runs_dataset, runs_of_dataset
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.catalogue import definition_of
from concord.studies.monte_carlo.simulate import OPTIONAL, simulate
from tests.experiments.support import small

NUMBERS = [3, 0, 7, 5]
SETUPS = {
    "smoothed states": small(nodes=3, steps=9, rule="labelled", smooth_steps=2),
    "contests and losses": small(
        nodes=5, steps=8, rule="ci", rounds=2, schedule="hybrid", occupancy=0.6, loss=0.3
    ),
    "nodes that check themselves": small(nodes=6, steps=7, graph="complete", rule="trimmed-ci"),
    "nodes that are out, and a controller": small(
        "dc-motor-speed", nodes=3, steps=8, changes=("2 kill 1", "5 restart 1")
    ),
}
NOT_IN_A_FILE = {"setup", "spreads", "history", "extras"}


def parts_of(runs: Runs) -> dict[str, Any]:
    """All arrays of a record by name, those of innovations, links and counters too."""
    found: dict[str, Any] = {}
    for name, one in runs._asdict().items():
        if name in NOT_IN_A_FILE:
            continue
        if isinstance(one, dict):
            found |= {f"{name} {of}": part for of, part in one.items()}
        elif isinstance(one, tuple):
            found |= {f"{name} {place}": part for place, part in enumerate(one)}
        else:
            found[name] = one
    return found


def assert_equal(one: Runs, other: Runs, rounding: float = 0.0) -> None:
    ours, theirs = parts_of(one), parts_of(other)
    assert ours.keys() == theirs.keys()
    for name, values in ours.items():
        if values is None:
            assert theirs[name] is None, name
        else:
            of_size = {"rtol": rounding, "atol": rounding, "err_msg": name}
            np.testing.assert_allclose(values, theirs[name], **of_size)
            assert values.dtype.kind == theirs[name].dtype.kind, name


@pytest.fixture(scope="module")
def records() -> dict[str, Runs]:
    return {name: simulate(one, NUMBERS, keep=OPTIONAL) for name, one in SETUPS.items()}


@pytest.mark.parametrize("name", SETUPS)
def test_a_data_set_holds_the_whole_record(name: str, records: dict[str, Runs], tmp_path: Path):
    runs, setup = records[name], SETUPS[name]
    data = runs_dataset(runs)
    assert_equal(runs_of_dataset(data, setup), runs)
    own = runs_of_dataset(data)
    assert_equal(own, runs)
    assert own.setup.scenario == setup.scenario
    write_dataset(data, tmp_path / "run.nc")
    read, cost = read_runs(tmp_path / "run.nc", setup)
    assert_equal(read, runs)
    assert cost is None


def test_a_data_set_of_other_nodes_or_of_no_scenario_is_refused(records: dict[str, Runs]):
    data = runs_dataset(records["smoothed states"])
    with pytest.raises(ValueError, match="runs of other nodes or states"):
        runs_of_dataset(data, SETUPS["contests and losses"])
    with pytest.raises(ValueError, match="runs of other nodes or states"):
        runs_of_dataset(data.isel(run=0), SETUPS["smoothed states"])
    for lacking in ("mean", "truth"):
        with pytest.raises(ValueError, match=lacking):
            runs_of_dataset(data.drop_vars(lacking), SETUPS["smoothed states"])
    del data.attrs["scenario"]
    with pytest.raises(ValueError, match="holds no runs of a scenario"):
        runs_of_dataset(data)


@pytest.mark.parametrize("name", SETUPS)
def test_parts_of_a_record_joined_are_the_whole(name: str, records: dict[str, Runs]):
    runs = records[name]
    assert_equal(joined([runs.of(slice(0, 1)), runs.of(slice(1, 4))]), runs)
    each = [simulate(SETUPS[name], [number], keep=OPTIONAL) for number in NUMBERS]
    assert_equal(joined(each), runs, 1e-9)
    assert joined([runs]) is runs


def test_a_counter_that_one_part_lacks_is_zero_there(records: dict[str, Runs]):
    runs = records["contests and losses"]
    first, second = runs.of(slice(0, 1)), runs.of(slice(1, 4))
    one = second._replace(counters={**second.counters, "odd": np.full((3, 5), 4)})
    found = joined([first, one]).counters["odd"]
    assert found.tolist() == [[0] * 5, [4] * 5, [4] * 5, [4] * 5]


def test_errors_of_the_past_are_those_of_the_steps_that_it_is_about(records: dict[str, Runs]):
    """Lag by lag, run by run and step by step; what lies before the run says nothing."""
    runs = records["smoothed states"]
    counted = np.ones((4, 9), bool)
    counted[:, :2] = counted[1, 4] = False
    assert runs.readings is not None and runs.past is not None
    central = centralised_of_runs(runs.setup, runs.runs.tolist(), runs.readings, runs.control)
    found = smoothed_errors(runs.setup, runs.past, central, runs.truth, runs.control, counted)
    states = list(definition_of(runs.setup.scenario).score.states)
    assert found.network.shape == found.centralised.shape == (4, 3)
    for run, lag in np.ndindex(4, 3):
        squares = [
            (
                (runs.past.mean[run, step, lag, node] - runs.truth[run, step - lag])[states] ** 2
            ).sum()
            for step in range(lag, 9)
            for node in range(3)
            if counted[run, step - lag]
            for error in [runs.past.mean[run, step, lag, node] - runs.truth[run, step - lag]]
        ]
        assert found.network[run, lag] == pytest.approx(np.sqrt(np.mean(squares)))
    of_now = [
        np.sqrt(np.mean(((central.mean - runs.truth)[run, counted[run]][:, states] ** 2).sum(-1)))
        for run in range(4)
    ]
    np.testing.assert_allclose(found.centralised[:, 0], of_now)
    # With a reading more the smoother of one step knows better, over all runs.
    assert (found.centralised[:, 1] ** 2).sum() < (found.centralised[:, 0] ** 2).sum()


def test_lags_are_counted_back_from_each_step():
    values = np.arange(2 * 4 * 3.0).reshape(2, 4, 3)
    found = lagged(values, 6)
    for run, step, lag in np.ndindex(2, 4, 6):
        expected = values[run, step - lag] if lag <= step else [np.nan] * 3
        np.testing.assert_array_equal(found[run, step, lag], expected)
    lags = [shown_lags(n) for n in (1, 2, 3, 5, 9, 10, 12)]
    assert lags[:5] == [[0], [0, 1], [0, 1, 2], [0, 1, 2, 4], [0, 1, 2, 4, 8]]
    assert lags[5:] == [[0, 1, 2, 4, 8, 9], [0, 1, 2, 4, 8, 11]]


def test_smoothed_figures_are_of_each_lag_in_order():
    setup = small(nodes=3, steps=26, rule="labelled", smooth_steps=2)
    runs = simulate(setup, NUMBERS, keep=OPTIONAL)
    told = summarise(runs).details["smoothed"]
    numbers, readings = runs.runs.tolist(), runs.readings
    assert readings is not None
    belief = centralised_of_runs(runs.setup, numbers, readings, runs.control, runs.prior_mean)
    network, centre = RunView(runs, without_bound(belief)).smoothed or ((), ())
    assert [one.lag for one in told] == [0, 1, 2]
    for lag, one in enumerate(told):
        assert one.rmse.value == pytest.approx(np.sqrt(np.mean(np.square(network)[:, lag])))
        ratio = np.mean(np.square(network)[:, lag]) / np.mean(np.square(centre)[:, lag])
        assert one.to_centralised.value == pytest.approx(np.sqrt(ratio))


@pytest.mark.parametrize(
    "changes", [("2 kill 1", "5 restart 1"), ("3 kill 0", "3 kill 2", "6 restart 2")]
)
def test_arrays_tell_the_outages_that_messages_tell(changes: tuple[str, ...]):
    setup = small(nodes=4, steps=9, graph="complete", changes=changes)
    recorded = runs_of_trace(setup, read_trace(setup, in_memory(setup)))
    found = outages_of(simulate(setup, [setup.scenario.run]))
    assert found == outages_of(recorded) and len(found) == len(changes) - 1
