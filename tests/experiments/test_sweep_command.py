"""`concord sweep` end to end: the file, going on, the same from any number of workers."""

import json
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import xarray

from concord.experiments.__main__ import main
from concord.studies.sweep.engines import engine_for
from concord.studies.sweep.results import read_result
from concord.studies.sweep.run import Swept, begin, finish
from concord.studies.sweep.specification import Specification, specify
from concord.studies.sweep.store import folder_of
from concord.studies.sweep.summary import figures_of
from concord.studies.sweep.workers import in_this_process
from tests.processes import CONCORD, family, interrupted

pytestmark = pytest.mark.slow

ASKED = {"scenario": "oscillator", "nodes": "3", "steps": "24", "graph": "ring,path",
         "occupancy": "1,.5"}  # fmt: skip
COMMAND = [part for field, text in ASKED.items() for part in (f"--{field}", text)]


def swept(specification: Specification, out: Path | None = None):
    return finish(begin(specification, out), in_this_process, lambda _: None)


def whole(found: Swept) -> xarray.Dataset:
    assert found.dataset is not None
    return found.dataset


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sweep") / "s.nc"
    swept(specify(ASKED, runs=3), path)
    return path


def test_the_result_has_a_dimension_per_field_units_and_provenance(result: Path):
    data = read_result(result)
    assert data["rmse"].dims == ("graph", "occupancy", "run")
    assert data["error"].dims == ("graph", "occupancy", "run", "step")
    assert data["graph"].to_numpy().tolist() == ["ring", "path"]
    assert data["rmse"].attrs["units"] == "m" and data["bus_load"].attrs["units"] == "1"
    assert data["time"].attrs["units"] == "s"
    assert data["state_unit"].to_numpy().tolist() == ["m", "m/s"]
    assert data.attrs["seed"] == 1 and "numpy" in json.loads(data.attrs["versions"])
    assert data.attrs["commit"]
    assert not folder_of(result).exists()


def test_a_cell_is_the_run_of_that_name(result: Path, capsys: pytest.CaptureFixture[str]):
    fields = [*COMMAND[:6], "--graph", "path", "--occupancy", "0.5", "--run", "2", "--json"]
    main(["run", *fields, "--out", str(result.with_name("run"))])
    alone = json.loads(capsys.readouterr().out)
    cell = read_result(result).sel(graph="path", occupancy=0.5, run=2)
    for name in ("rmse", "anees", "bus_load"):
        assert float(cell[name]) == pytest.approx(alone[name][0], rel=1e-9)


def test_noise_is_common_to_all_cells(result: Path):
    central = read_result(result)["rmse_centralised"].to_numpy()
    assert np.array_equal(central, np.broadcast_to(central[0, 0], central.shape))
    assert len(np.unique(central[0, 0])) == 3


class Stopped(Exception):
    """Exception that ends a sweep in these tests."""


def stopping(after: int):
    def engine(function, arguments):
        for place, argument in enumerate(arguments):
            if place == after:
                raise Stopped
            yield place, function(argument)

    return engine


def test_a_sweep_goes_on_where_it_stopped(result: Path, tmp_path: Path):
    out, specification = tmp_path / "s.nc", specify(ASKED, runs=3)
    with pytest.raises(Stopped):
        finish(begin(specification, out), stopping(after=2), lambda _: None)
    assert not out.exists()
    # A file that was being written when the power went is as if it were not there.
    sorted(folder_of(out).glob("*.npz"))[1].write_bytes(b"PK\x03\x04 half")
    again = swept(specification, out)
    assert (again.found_pieces, again.computed_pieces) == (1, 3)
    assert whole(again).equals(read_result(result))
    finished = swept(specification, out)
    assert finished.computed_pieces == 0
    assert whole(finished).equals(whole(again))


def test_it_does_not_go_on_with_another_sweep(tmp_path: Path):
    out = tmp_path / "s.nc"
    with pytest.raises(Stopped):
        finish(begin(specify(ASKED, runs=3), out), stopping(after=1), lambda _: None)
    with pytest.raises(ValueError, match=r"nodes was 3 and is 4.*remove .*s.nc.pieces"):
        begin(specify({**ASKED, "nodes": "4"}, runs=3), out)
    with pytest.raises(ValueError, match="runs was 3 and is 4"):
        begin(specify(ASKED, runs=4), out)


def test_it_is_not_written_over_another_sweep(result: Path, tmp_path: Path):
    copy = tmp_path / "s.nc"
    shutil.copy(result, copy)
    with pytest.raises(ValueError, match="graph was ring,path and is ring,star"):
        begin(specify({**ASKED, "graph": "ring,star"}, runs=3), copy)
    foreign = tmp_path / "foreign.nc"
    foreign.write_bytes(b"not netCDF")
    with pytest.raises(ValueError, match="cannot be read as netCDF"):
        begin(specify(ASKED, runs=3), foreign)


def test_two_sweeps_of_one_second_have_files_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The second one took the pieces of the first for its own, and was refused."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "strftime", lambda _: "20260101-000000")
    for seed in ("1", "2"):
        main(["sweep", *COMMAND, "--seed", seed, "--runs", "2", "--workers", "1"])
    assert len(list(Path("runs").glob("sweep-20260101-000000-*.nc"))) == 2


@pytest.mark.slow
def test_two_workers_find_what_one_finds(result: Path, tmp_path: Path):
    done = finish(begin(specify(ASKED, runs=3), None), engine_for(2, None), lambda _: None)
    assert whole(done).equals(read_result(result))


@pytest.mark.slow
def test_so_do_the_workers_of_a_dask_scheduler(result: Path, tmp_path: Path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
        local_directory=str(tmp_path),
    ) as cluster:  # fmt: skip
        engine = engine_for(None, cluster.scheduler_address)
        done = finish(begin(specify(ASKED, runs=3), None), engine, lambda _: None)
    assert whole(done).equals(read_result(result))


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install '\.\[dask\]'"):
        engine_for(None, "tcp://127.0.0.1:1")


def test_workers_and_dask_are_one_choice():
    with pytest.raises(ValueError, match="leave one of them out"):
        engine_for(2, "tcp://127.0.0.1:1")
    with pytest.raises(ValueError, match="at least 1"):
        engine_for(0, None)


def test_a_latin_hypercube_has_its_cells_in_a_row(tmp_path: Path):
    asked = {**ASKED, "occupancy": "0.3..1", "decay": "0..1"}
    data = whole(swept(specify(asked, runs=2, samples=3), tmp_path / "h.nc"))
    assert data["rmse"].dims == ("cell", "run")
    assert set(data.coords) >= {"graph", "occupancy", "decay"}
    assert figures_of(data).cells[2].cell["decay"] == float(data["decay"][2])


def test_cells_of_any_size_stand_side_by_side():
    asked = {"scenario": "oscillator", "nodes": "3,4", "steps": "5,8"}
    data = whole(swept(specify(asked, runs=2)))
    small = data.sel(nodes=3, steps=5)
    assert np.isnan(small["rmse_node"][:, 3]).all() and np.isnan(small["error"][:, 5:]).all()
    assert not np.isnan(data["rmse"]).any()
    assert all(np.isfinite(cell["rmse"].value) for cell in figures_of(data).cells)


def test_one_cell_is_a_sweep_too():
    asked = {"scenario": "oscillator", "nodes": "3", "steps": "5"}
    done = swept(specify(asked, runs=2))
    assert whole(done)["rmse"].dims == ("run",)
    assert done.node_updates == 2 * 3 * 5


def test_errors_in_different_units_are_not_put_in_one_table():
    asked = {"scenario": "oscillator,dc-motor-speed", "nodes": "4", "steps": "3"}
    with pytest.raises(ValueError, match="measure their errors in"):
        begin(specify(asked, runs=1), None)


def test_the_command_prints_figures_for_machines(result: Path, capsys: pytest.CaptureFixture[str]):
    main(["sweep", *COMMAND, "--runs", "3", "-o", str(result), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed["computed_pieces"] == 0 and printed["unit"] == "m"
    first = printed["cells"][0]
    assert first["cell"] == {"graph": "ring", "occupancy": 1.0}
    value, low, high = first["to_centralised"]
    assert low < value < high
    assert first["published"][0] == 1.0


def test_the_best_cell_is_compared_with_itself_and_the_others_with_it(result: Path):
    cells = figures_of(read_result(result)).cells
    ratios = [cell["to_best"].value for cell in cells]
    assert min(ratios) == 1 and max(ratios) > 1
    best = cells[ratios.index(1)]
    assert best["rmse"].value == min(cell["rmse"].value for cell in cells)


@pytest.mark.slow
def test_ctrl_c_keeps_finished_pieces_and_ends_every_worker(tmp_path: Path):
    command = [
        *CONCORD, "sweep", "--scenario", "oscillator", "--nodes", "4",
        "--steps", "40", "--seed", "1..30", "--runs", "4", "--workers", "2", "-o", "s.nc",
    ]  # fmt: skip
    folder = folder_of(tmp_path / "s.nc")
    with family(command, tmp_path) as run:
        said = interrupted(run, lambda: list(folder.glob("*.npz")))
    assert "go on with: concord sweep --scenario oscillator" in said
    kept = len(list(folder.glob("*.npz")))
    assert 0 < kept < 30 and not (tmp_path / "s.nc").exists()
    again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert f"goes on: {kept} of 30 pieces were computed before" in again.stderr
    assert (tmp_path / "s.nc").exists() and not folder.exists()
