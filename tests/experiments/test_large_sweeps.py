"""Sweeps that keep moments, shards, and pieces that other sweeps find."""

import random
from pathlib import Path

import numpy as np
import pytest
import xarray

import concord as cc
from concord.experiments.__main__ import main
from concord.features.vehicle.plant.drive_log import write_drive
from concord.studies.sweep import pieces as pieces_module
from concord.studies.sweep.cells import MOST_WITH_HISTORIES, with_keep
from concord.studies.sweep.merge import merge_shards
from concord.studies.sweep.run import Shard, begin, finish
from concord.studies.sweep.specification import Specification, specify
from concord.studies.sweep.store import folder_of
from concord.studies.sweep.summary import figures_of
from concord.studies.sweep.workers import in_this_process
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log

pytestmark = pytest.mark.slow

ASKED = {"scenario": "oscillator", "nodes": "3,4", "steps": "24"}


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch):
    """Pieces of 4 and 5 runs, of moments of 8 and 11, so that a cell has several."""
    monkeypatch.setattr(pieces_module, "LARGEST", 400)


def specified(keep: str, runs: int = 24, **asked: str) -> Specification:
    return with_keep(specify(ASKED | asked, runs=runs), keep)


def swept(specification: Specification, out: Path | None = None, **where):
    return finish(begin(specification, out, **where), in_this_process, lambda _: None)


def whole(specification: Specification) -> xarray.Dataset:
    dataset = swept(specification).dataset
    assert dataset is not None
    return dataset


def equal(one, other) -> bool:
    """Whether two data sets have the same bits, but for the specification."""
    return all(one[name].to_numpy().tobytes() == other[name].to_numpy().tobytes() for name in one)


def test_moments_and_figures_are_those_of_the_histories():
    found = {keep: whole(specified(keep)) for keep in pieces_module.REDUCED}
    assert "run" not in found["moments"].dims and "run" in found["figures"]["rmse"].dims
    assert found["figures"]["error"].dims == ("nodes", "statistic", "step")
    np.testing.assert_array_equal(found["figures"]["rmse"], found["histories"]["rmse"])
    tables = {keep: figures_of(data).cells for keep, data in found.items()}
    for keep in ("moments", "figures"):
        for mine, theirs in zip(tables[keep], tables["histories"], strict=True):
            assert mine.figures.keys() == theirs.figures.keys()
            for name in mine.figures:
                got, expected = np.array(mine[name]), np.array(theirs[name])
                known = ~np.isnan(got)
                assert known[0] == ~np.isnan(expected[0]), name
                np.testing.assert_allclose(got[known], expected[known], rtol=1e-9, err_msg=name)
    bound = found["histories"]["bound"]
    np.testing.assert_allclose(found["moments"]["bound"], bound, rtol=1e-12)


def test_large_sweeps_keep_moments_by_themselves():
    small, runs = specify(ASKED), MOST_WITH_HISTORIES // (24 * 7) + 1
    assert with_keep(small, None).keep == "histories"
    assert with_keep(specify(ASKED, runs=runs), None).keep == "moments"


@pytest.mark.parametrize("keep", ["moments", "figures", "histories"])
def test_shards_in_any_order_are_the_undivided_sweep(keep: str, tmp_path: Path):
    specification, shards = specified(keep, runs=48), 10
    undivided = whole(specification)
    outs = [tmp_path / f"{number}.nc" for number in range(1, shards + 1)]
    numbers = random.Random(3).sample(range(1, shards + 1), shards)
    assert numbers != sorted(numbers)
    pieces = {"moments": 11, "figures": 22, "histories": 22}[keep]
    for number in numbers:
        done = swept(specification, outs[number - 1], shard=Shard(number, shards))
        assert done.dataset is None
        assert done.computed_pieces == len(range(number, pieces + 1, shards))
    folders = [folder_of(outs[number - 1]) for number in numbers]
    with pytest.raises(ValueError, match=rf"of {pieces} pieces are missing, the first of cell n"):
        merge_shards(folders[1:], tmp_path / "m.nc")
    assert equal(merge_shards(folders, tmp_path / "m.nc"), undivided)
    with cc.load(tmp_path / "m.nc") as read:
        # Nothing is read before it is used.
        assert not read["rmse"].variable._in_memory
        assert equal(read[list(undivided)], undivided)


def test_shards_of_different_sweeps_are_not_merged(tmp_path: Path):
    for number, nodes in ((1, "3"), (2, "4")):
        out = tmp_path / f"{number}.nc"
        swept(specified("moments", nodes=nodes), out, shard=Shard(number, 2))
    folders = [tmp_path / f"{number}.nc.pieces" for number in (1, 2)]
    with pytest.raises(ValueError, match=r"another sweep than .*: nodes was 3 and is 4"):
        merge_shards(folders, tmp_path / "m.nc")


def test_another_sweep_finds_the_pieces_of_the_same_cells(tmp_path: Path):
    kept = tmp_path / "kept"
    kept.mkdir()
    first = swept(specified("moments", runs=20), tmp_path / "a.nc", pieces=kept)
    assert (first.found_pieces, first.computed_pieces) == (0, 5)
    # Twenty runs are two whole pieces of the cell with 4 nodes, and a half.
    more = swept(specified("moments", runs=24, nodes="4,5"), tmp_path / "b.nc", pieces=kept)
    assert (more.found_pieces, more.computed_pieces) == (2, 5)
    assert equal(more.dataset, whole(specified("moments", runs=24, nodes="4,5")))


def test_what_a_piece_follows_from_is_in_its_name():
    (piece, *_), by = (
        pieces_module.pieces_of(spec := specified("moments"), begin(spec, None).cells),
        pieces_module.program(),
    )
    name = pieces_module.digest_of(piece, {}, by)
    others = [
        (piece._replace(first=1), {}, by),
        (piece._replace(keep="figures"), {}, by),
        (piece._replace(scenario=piece.scenario.replace(b'"seed":1', b'"seed":2')), {}, by),
        (piece, {"oscillator": "other content"}, by),
        (piece, {}, pieces_module.Origin(by.versions, "another commit")),
    ]
    assert name not in {pieces_module.digest_of(*other) for other in others}
    assert name == pieces_module.digest_of(piece._replace(cell=7), {"./unused.py:X": "1"}, by)


def test_pieces_of_a_log_are_those_of_its_content(tmp_path: Path):
    """Another log at the same path shares no piece with it; the same log at the same path does."""
    log, kept = tmp_path / "log", tmp_path / "pieces"
    log.mkdir()
    kept.mkdir()
    asked = {"scenario": "vehicle-network", "filter": "ukf", "steps": "30", "data": str(log)}

    def of_log(seed: int, out: str) -> tuple[int, xarray.Dataset]:
        write_drive(log, simulated_log(TRUE, 0.3, seed)[0], TRUE)
        done = swept(specify(asked, runs=1), tmp_path / out, pieces=kept)
        assert done.dataset is not None
        return done.found_pieces, done.dataset

    (none, first), (one, again), (other, second) = of_log(1, "a"), of_log(1, "b"), of_log(2, "c")
    assert (none, one, other) == (0, 1, 0)
    assert equal(first, again) and not equal(first, second)


def test_moments_are_printed_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "s.nc"
    fields = [part for field, text in ASKED.items() for part in (f"--{field}", text)]
    main(["sweep", *fields, "--runs", "6", "--keep", "moments", "--workers", "1", "-o", str(out)])
    printed = capsys.readouterr()
    assert "2 cells of 6 runs" in printed.out and "keeps moments" in printed.err
    main(["plot", str(out), "--out", str(tmp_path)])
    assert (tmp_path / "error-over-time.png").stat().st_size > 10_000
