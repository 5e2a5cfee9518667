"""Progress of a sweep: a folder beside its result, with one file per finished cell.

A cell is written whole or not at all, so an interrupted sweep continues where it stopped.
"""

import shutil
import zipfile
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np

from concord.experiments.places import make_folder
from concord.experiments.results.folder import commit, versions
from concord.experiments.sweep.cells import difference
from concord.experiments.sweep.specification import Specification
from concord.runtime.disk import writing

SPECIFICATION = "sweep.json"


class Begun(msgspec.Struct, frozen=True):
    """Which sweep a folder is of, and what computed its cells."""

    specification: Specification
    versions: dict[str, str]
    commit: str | None


def folder_of(result: Path) -> Path:
    """Where the cells of a result wait until all are done."""
    return result.with_name(f"{result.name}.cells")


def open_store(result: Path, specification: Specification) -> Path:
    """Return the folder of the cells of a result; made, or found with some of them.

    Raises:
        ValueError: it cannot be made, or it is of another sweep or another version.
    """
    folder = folder_of(result)
    now = Begun(specification, versions(), commit())
    make_folder(folder, "--out", result)
    described = folder / SPECIFICATION
    if not described.exists():
        _write(described, msgspec.json.format(msgspec.json.encode(now), indent=2))
        return folder
    try:
        before = msgspec.json.decode(described.read_bytes(), type=Begun)
    except msgspec.MsgspecError as error:
        raise ValueError(f"{described}: not a sweep of ours ({error}); remove {folder}") from None
    check_same(before.specification, specification, result, f"remove {folder} to begin anew")
    if before.versions != now.versions or before.commit != now.commit:
        raise ValueError(
            f"{folder}: begun by another version of the program (commit {before.commit}); cells "
            f"of two versions cannot stand side by side; remove it to begin anew"
        )
    return folder


def check_same(before: Specification, now: Specification, result: Path, cure: str) -> None:
    """Refuse to go on with, or write over, the result of another sweep.

    Raises:
        ValueError: they differ, and in what.
    """
    changed = difference(before, now)
    if changed:
        raise ValueError(
            f"{result} belongs to another sweep: {changed}; choose another --out, or {cure}"
        )


def save_cell(folder: Path, number: int, figures: dict[str, np.ndarray]) -> None:
    """Write a finished cell, whole or not at all."""
    path = _path(folder, number)
    part = path.with_suffix(".part")
    try:
        with writing(path):
            with part.open("wb") as file:
                np.savez(file, **figures)  # type: ignore[arg-type]
            part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def load_cells(folder: Path, numbers: Iterable[int]) -> dict[int, dict[str, np.ndarray]]:
    """The finished ones of these cells; one that cannot be read is as if it were not there."""
    found = {}
    for number in numbers:
        try:
            with _path(folder, number).open("rb") as file, np.load(file) as arrays:
                found[number] = {name: arrays[name] for name in arrays.files}
        except (OSError, ValueError, zipfile.BadZipFile):
            continue
    return found


def remove_store(result: Path) -> None:
    """Remove the cells of a result that is complete."""
    shutil.rmtree(folder_of(result), ignore_errors=True)


def _path(folder: Path, number: int) -> Path:
    return folder / f"cell-{number:05d}.npz"


def _write(path: Path, data: bytes) -> None:
    part = path.with_suffix(".part")
    with writing(path):
        part.write_bytes(data + b"\n")
        part.replace(path)
