"""Test the sentence that ends a run: its words follow from figures, end to end and one by one."""

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import xarray
from rich.console import Console

from concord.experiments.__main__ import main
from concord.results.figures.intervals import Interval
from concord.results.figures.summary import Summary
from concord.results.figures.summary_table import lines
from concord.results.innovations.diagnosis import Cause, Channel, Diagnosis
from concord.results.innovations.presentation import channel_table
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.scenario_definition import Explanation
from concord.scenarios.setup import Setup
from concord.studies import near_agreement
from concord.studies.monte_carlo.simulate import OPTIONAL, simulate
from concord.studies.near_agreement import departures
from tests.experiments.innovation_verdicts import (
    FITTING,
    OFF,
    OVER,
    TOO_SMALL,
    UNKNOWN,
    YAW,
    said,
    verdict,
)
from tests.experiments.support import scenario, small, summary_of

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        (Cause.OFFSET, "it reads 0.02 rad/s (95 %: 0.018 to 0.022) off its prediction"),
        (Cause.NOISE_TOO_SMALL, "its noise is larger than the filter's R, or it is biased by 0.02"),
        (Cause.NOISE_TOO_LARGE, "lower R"),
        (Cause.COLOURED, "correlate by 0.4: its errors are not white"),
        (Cause.ALL_NOISE_TOO_SMALL, "other sensors are alike"),
        (Cause.ALL_NOISE_TOO_LARGE, "other sensors are alike"),
        (Cause.PROCESS_NOISE_TOO_SMALL, "process noise Q is too small"),
        (Cause.PROCESS_NOISE_TOO_LARGE, "process noise Q is too large"),
        (Cause.MODEL, "the model does not move as the readings do"),
    ],
)
def test_each_cause_has_its_words(cause: Cause, words: str):
    sentence = said(cause)
    assert sentence.startswith("overconfident: NIS of node 2's yaw rate is 14 where 1 is right")
    assert words in sentence


def test_other_channels_are_counted():
    assert said(Cause.OFFSET, 1).endswith("; 1 more channel deviates, less so")
    assert said(Cause.OFFSET, 3).endswith("; 3 more channels deviate, less so")


@pytest.mark.parametrize(
    ("nis", "anees", "level", "words"),
    [
        (
            FITTING,
            FITTING,
            "WORKS",
            "consistent: models and sensors fit the readings (NIS 1, ANEES 1",
        ),
        (FITTING, UNKNOWN, "WORKS", "consistent: models and sensors fit the readings (NIS 1 where"),
        (FITTING, Interval(0.64, 0.4, 0.9), "WORKS", "claim errors 1.25 x those they make (AN"),
        (FITTING, Interval(2.0, 1.5, 2.5), "CHECK", "but rule ci claims too much (ANEES 2 where"),
        (Interval(1.5, 1.2, 1.8), UNKNOWN, "CHECK", "but rule ci claims too much (NIS 1.5 where"),
        (FITTING, Interval(1.05, 1.01, 1.09), "WORKS", "consistent"),
        (FITTING, Interval(2.0, 0.8, 5.0), "WORKS", "consistent"),
        (FITTING, Interval(2.0, 0.02, 50.0), "CHECK", "ANEES 2 may be 0.02 to 50"),
        (FITTING, Interval(0.9, np.nan, np.nan), "CHECK", "too few scored steps to judge ANEES 0."),
    ],
)
def test_estimates_are_judged_where_sensors_and_models_fit(nis, anees, level: str, words: str):
    found = verdict(scenario("oscillator"), Diagnosis(Cause.NONE), nis, anees)
    assert words in found.said and found.level == level
    assert (found.cause == "too short") == (found.cure == "use --steps 99")


def test_a_run_in_which_a_value_is_named_is_not_called_consistent():
    """A verdict said "consistent", and named a delay whose interval excluded that of the file."""
    named = "of single values of car.toml, delay of side slip explains most: 0.0192 s"
    given = scenario("vehicle-network"), Diagnosis(Cause.NONE), FITTING, FITTING
    said = verdict(*given, Explanation(cause=named)).said
    assert said.startswith("undecided: models and sensors fit the readings (NIS 1")
    assert said.endswith(f"; yet {named}")


def test_a_reading_in_another_unit_is_no_fault_of_the_car():
    """The verdict on a yaw rate in deg/s, read as rad/s, asked for a process noise of 0.9."""
    wild = OFF._replace(nis=Interval(2000.0, 1900.0, 2100.0), spread=2000.0)
    of_readings = Diagnosis(Cause.NOISE_TOO_SMALL, YAW, wild)
    given = scenario("vehicle-network"), of_readings, FITTING, UNKNOWN
    told = Explanation(cause="Q explains most", misread="look at its units")
    sentence = verdict(*given, told).said
    assert sentence.endswith("; look at its units")
    assert "explains most" not in sentence


def test_errors_lead_where_innovations_are_small():
    of_readings = Diagnosis(Cause.NOISE_TOO_LARGE, YAW, TOO_SMALL)
    sentence = verdict(scenario("oscillator"), of_readings, FITTING, OVER).said
    assert sentence.startswith("overconfident: ANEES is 2.9 where 1 is right")
    assert "innovations alone would say underconfident: NIS of node 2's yaw rate" in sentence


def test_an_offset_beside_another_cause_is_named_too():
    noisy = Channel(0, 0, 0, "speed", "m/s")
    diagnosis = Diagnosis(Cause.NOISE_TOO_SMALL, noisy, OFF, 1, (YAW, OFF))
    sentence = verdict(scenario("oscillator"), diagnosis, FITTING, FITTING).said
    assert "NIS of node 0's speed" in sentence
    assert sentence.endswith("besides, node 2's yaw rate reads 0.02 rad/s (95 %: 0.018 to 0.022) "
                             "off its prediction")  # fmt: skip


@pytest.mark.parametrize(("shift", "lead"), [(0.2, "underconfident"), (-0.9, "biased")])
def test_small_innovations_of_one_channel_are_no_caution_beside_an_offset(shift: float, lead: str):
    """A real car, whose steering read 8 degrees too much, was called underconfident."""
    noisy, off = Channel(1, 0, 1, "lateral acceleration", "m/s²"), OFF._replace(shift=shift)
    diagnosis = Diagnosis(Cause.NOISE_TOO_LARGE, noisy, TOO_SMALL, 1, (YAW, off))
    given = scenario("vehicle-network"), diagnosis, FITTING, UNKNOWN
    for named in ("", "of single values of car.toml, rear stiffness explains most"):
        sentence = verdict(*given, Explanation(cause=named)).said
        assert sentence.startswith(f"{lead}: NIS of node 1's lateral acceleration is")
        assert named in sentence
        if lead == "biased":
            assert "besides, node 2's yaw rate reads 0.02 rad/s" in sentence


def test_too_few_readings_are_no_verdict():
    nothing = Diagnosis(Cause.UNKNOWN)
    few = verdict(scenario("oscillator"), nothing, UNKNOWN, UNKNOWN)
    assert "too few readings to judge" in few.said and few.level == "CHECK"


def figures(**options) -> Summary:
    setup = small(**{"steps": 220, "seed": 3, "rule": "labelled", **options})
    return summary_of(setup, read_trace(setup, in_memory(setup)))


def test_a_run_whose_models_are_right_is_consistent():
    found = figures()
    assert found.verdict.level == "WORKS" and found.verdict.said.startswith("consistent: ")
    assert found.innovations is not None
    low, high = found.innovations.centralised.interval or (np.nan, np.nan)
    assert low < 1 < high
    assert [one.name for one in found.innovations.channels] == ["position", "velocity", "position"]


def test_a_sensor_with_an_offset_is_named_by_a_run():
    found = figures(changes=("0 bias 2 2",))
    assert found.verdict.level == "CHECK" and found.verdict.cause == "offset of a sensor"
    assert "correct its offset" in found.verdict.said
    first = found.verdict.findings[0]
    assert (first.node, first.sensor) == (2, "position")
    assert found.innovations is not None
    channel = next(one for one in found.innovations.channels if one.node == 2)
    low, high = channel.mean_interval or (np.nan, np.nan)
    # Two standard deviations of 0.5 m; the filter takes a part of them for motion.
    assert 0 < low < high < 1.0


def test_a_sensor_that_delivers_outliers_is_named_by_a_run():
    found = figures(changes=("0 outlier 0 .3 6",))
    assert found.verdict.said.startswith("overconfident: NIS of node 0's")


def without_truth(setup: Setup) -> Summary:
    trace = read_trace(setup, in_memory(setup))
    return summary_of(setup, trace._replace(truth=np.full_like(trace.truth, np.nan)))


def test_a_run_without_truth_has_figures_and_a_verdict():
    found = without_truth(small(steps=120, seed=3, rule="labelled"))
    assert found.verdict.said.startswith("consistent")
    assert "ANEES" not in found.verdict.said
    assert not any("nan" in line for line in lines(found))


def test_json_has_the_verdict_and_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    options = f"run --scenario oscillator --nodes 4 --steps 60 --json --out {tmp_path}/run"
    main(options.split())
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] and len(told["innovations"]["channels"]) == 3
    assert {"nis", "mean", "correlation", "p_white"} <= set(told["innovations"]["channels"][0])


def test_the_first_word_of_a_run_is_its_level_and_its_folder_keeps_it(tmp_path: Path, capsys):
    main(f"run --scenario oscillator --nodes 4 --steps 60 --out {tmp_path}/run".split())
    assert capsys.readouterr().out.startswith("WORKS  4 nodes took 60 steps")
    kept = json.loads((tmp_path / "run" / "run.json").read_text())["verdict"]
    assert kept["level"] == "WORKS" and kept["cause"] in ("consistent", "cautious")


def test_sets_have_no_innovations():
    setup = small("liu2021-network", nodes=6, steps=5, rule="ellipsoid")
    trace = read_trace(setup, in_memory(setup))
    found = summary_of(setup, trace)
    assert found.innovations is None
    assert found.verdict.said == "sets: 0 of 30 do not hold the truth"


def test_the_batched_driver_has_the_innovations_of_messages(monkeypatch: pytest.MonkeyPatch):
    setup = small("target-tracking", nodes=5, steps=25)
    trace = read_trace(setup, in_memory(setup))
    expected = runs_of_trace(setup, trace).innovations
    found = simulate(setup, [0], keep=["readings", "innovations"]).innovations
    assert expected is not None and found is not None
    for own, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-8, atol=1e-10)
    assert simulate(setup, [0]).innovations is None  # kept where they are asked for
    assert "innovation" not in departures(setup, trace)
    # Innovations follow estimates and readings; they are named where they depart alone.
    shifted = trace._replace(mean=trace.mean + 1e-4)
    assert set(departures(setup, shifted)) == {"mean"}
    histories = simulate(setup, [0], keep=OPTIONAL)
    assert histories.innovations is not None
    wrong = histories.innovations._replace(value=histories.innovations.value + 1e-4)
    monkeypatch.setattr(
        near_agreement, "simulate", lambda *_, **__: histories._replace(innovations=wrong)
    )
    assert set(departures(setup, trace)) == {"innovation"}


@pytest.mark.parametrize("options", ["oscillator --nodes 4", "vehicle-network"])
def test_many_runs_have_innovations_and_a_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: str
):
    """A vehicle's nodes learn their noise, so its runs go one by one."""
    runs = f"--steps 60 --driver batched --runs 2 --json --out {tmp_path}/run"
    main(f"run --scenario {options} {runs}".split())
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] and told["innovations"]["channels"]
    with xarray.open_dataset(tmp_path / "run" / "run.nc", engine="h5netcdf") as data:
        assert data["innovation"].dims == ("run", "step", "node", "reading", "entry")
        assert data["nis"].dims == ("run", "step", "node", "reading")
        taken = np.isfinite(data["readings"].to_numpy()).any(axis=-1)
        np.testing.assert_array_equal(np.isfinite(data["nis"].to_numpy()), taken)


def test_the_table_of_channels_fits_eighty_columns():
    console = Console(markup=False, width=80, record=True, file=StringIO())
    found = figures(steps=40).innovations
    assert found is not None
    console.print(channel_table(found))
    text = console.export_text()
    assert "0: position [m]" in text and "…" not in text
