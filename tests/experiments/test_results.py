"""Test the files of a run: run.json repeats its figures, run.nc holds the recording's content."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray

import concord as cc
from concord.filters.metrics import nees
from concord.results.folder import (
    describe,
    new_folder,
    read_description,
    write_description,
)
from concord.results.records.netcdf_file import ARRAYS, DESCRIPTION, write_dataset
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.scenario import Scenario
from tests.experiments.support import scenario, small, write_arrays

SETUP = small(steps=6, nodes=3, graph="path", schedule="round-robin", occupancy=0.4)
TRACE = read_trace(SETUP, in_memory(SETUP))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("arrays")
    write_arrays(folder, SETUP, TRACE)
    with xarray.open_dataset(folder / ARRAYS, engine="h5netcdf") as opened:
        yield opened.load()


@pytest.mark.parametrize("quantity", ["truth", "mean", "cov", "readings"])
def test_arrays_keep_their_bits(dataset, quantity: str):
    stored = dataset[quantity].isel(run=0).to_numpy()
    expected = getattr(TRACE, quantity)
    assert stored.dtype == expected.dtype
    assert stored.tobytes() == expected.tobytes()


def test_what_is_derived_agrees_with_what_it_is_derived_from(dataset):
    ages = TRACE.ages[:, dataset["receiver"].to_numpy(), dataset["sender"].to_numpy()]
    np.testing.assert_array_equal(dataset["ages"].to_numpy()[0], ages)
    np.testing.assert_array_equal(dataset["payload_bytes"].to_numpy()[0] > 0, TRACE.published)
    np.testing.assert_allclose(
        dataset["nees"][0], nees(TRACE.mean - TRACE.truth[:, None], TRACE.cov), rtol=1e-12
    )
    assert dataset["sent"].to_numpy().tolist() == [[one["sent"] for one in TRACE.counters]]


def test_dimensions_and_units_have_names(dataset):
    assert dataset["mean"].dims == ("run", "step", "node", "state")
    assert dataset["payload_bytes"].dims == ("run", "step", "round", "node")
    assert dataset["state"].to_numpy().tolist() == ["x", "vx"]
    assert dataset["state_unit"].to_numpy().tolist() == ["m", "m/s"]
    assert list(np.atleast_1d(dataset["mean"].attrs["scored"])) == ["x"]
    assert dataset["mean"].attrs["scored_unit"] == "m"
    np.testing.assert_allclose(dataset["time"], np.arange(6) * SETUP.time_step_s)
    assert dataset["time"].attrs["units"] == "s"
    assert dataset.attrs["seed"] == SETUP.scenario.seed
    assert msgspec.json.decode(dataset.attrs["scenario"], type=Scenario) == SETUP.scenario
    assert dataset["mean"].sel(state="x").shape == (1, 6, 3)


def test_every_documented_variable_is_there(dataset):
    """docs/results.md names them in the first column of its table."""
    page = Path(__file__).parents[2] / "docs" / "results.md"
    section = page.read_text(encoding="utf-8").partition("## run.nc")[2].partition("Coordinates")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    named = {name.strip(" `") for row in rows for name in row.split(",")} - {"..."}
    assert {"truth", "mean", "cov", "ages"} <= named
    # The plant is no car and not controlled, the rule has no records and solves no programme, and
    # lockstep has no late estimates.
    elsewhere = {
        "control", "outside_model", "record_age", "estimate_age_s", "cut", "duality_gap", "suspect",
        "smoothed_mean", "smoothed_std",
    }  # fmt: skip
    assert named - set(dataset.variables) <= elsewhere | {"missed"}
    unnamed = set(dataset.data_vars) - named
    assert all("counter" in dataset[name].attrs for name in unnamed)


def test_ages_of_records_are_written_where_there_are_records(tmp_path: Path):
    setup = small(steps=6, nodes=4, graph="ring", rule="labelled", rounds=3)
    trace = read_trace(setup, in_memory(setup))
    write_arrays(tmp_path, setup, trace)
    with xarray.open_dataset(tmp_path / ARRAYS, engine="h5netcdf") as written:
        ages = written["record_age"]
        assert ages.dims == ("run", "step", "node", "source") and ages.shape == (1, 6, 4, 4)
        # On a ring of four with three rounds everything is everywhere within its step.
        seen = ~np.isnan(trace.readings).all(axis=(0, 2, 3))
        assert (ages.values[0][:, :, seen] == 0).all() and (ages.values[0][:, :, ~seen] == -1).all()


def test_the_description_comes_back_whole(tmp_path: Path):
    description = describe("a run", "processes", SETUP)
    write_description(tmp_path, description)
    assert read_description(tmp_path) == description
    assert description.setup == SETUP
    assert {"concord", "python", "numpy", "eclipse-zenoh"} <= set(description.versions)
    text = (tmp_path / DESCRIPTION).read_text()
    assert json.loads(text)["seed"] == 1
    assert len(text.splitlines()) > 20


@pytest.mark.parametrize("content", [None, b"", b"{}", b'{"run": 3}', b"no json"])
def test_a_folder_without_a_run_is_refused_by_name(tmp_path: Path, content: bytes | None):
    if content is not None:
        (tmp_path / DESCRIPTION).write_bytes(content)
    with pytest.raises(ValueError, match=rf"{DESCRIPTION}: (cannot be read|not the description)"):
        read_description(tmp_path)


def test_folders_have_names_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    made = [new_folder(None, "oscillator") for _ in range(20)]
    assert len({run for run, _ in made}) == len({folder for _, folder in made}) == 20
    assert all(folder.parent == Path("runs") and folder.is_dir() for _, folder in made)


def test_a_run_that_is_interrupted_while_it_writes_leaves_no_broken_arrays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Ctrl-C between the first and the last byte of run.nc: a whole file, or none."""
    write = Path.write_bytes

    def half(self, data):
        write(self, data[: len(data) // 2])
        assert [file.stat().st_size > 0 for file in tmp_path.iterdir()] == [True]
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(KeyboardInterrupt):
        write_arrays(tmp_path, SETUP, TRACE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("rule", ["ci", "labelled"])
def test_a_file_is_that_of_xarray(rule: str, compressed: bool, tmp_path: Path):
    """The writer is our own; xarray writes and reads the same data set with its own."""
    found = cc.simulate(scenario("target-tracking", nodes=4, steps=5, rule=rule), runs=2)
    found["flag"] = ("run", np.array([True, False]))
    found["note"] = ("run", ["a", "bc"])
    found["none"] = (("run", "empty"), np.empty((2, 0)))
    found = found.assign(number=7, word="one").assign_coords(apart=("elsewhere", [1.0, np.nan]))
    found.to_netcdf(tmp_path / "theirs.nc", engine="h5netcdf")
    write_dataset(found, tmp_path / "ours.nc", compressed)
    theirs, ours = (
        xarray.load_dataset(tmp_path / f"{name}.nc", engine="h5netcdf")
        for name in ("theirs", "ours")
    )
    xarray.testing.assert_identical(theirs, ours)
    for name in theirs.variables:
        assert theirs[name].dtype == ours[name].dtype, name
