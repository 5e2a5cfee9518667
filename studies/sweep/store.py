"""Progress of a sweep: a folder with one file per finished piece, under the digest of the piece.

A piece is written whole or not at all, so an interrupted sweep continues where it stopped.
"""

import shutil
import zipfile
from pathlib import Path

import msgspec
import numpy as np

from concord.disk import whole_file
from concord.results.places import make_folder
from concord.runtime.json_file import read_json, write_json
from concord.scenarios.user.trust import remember, require_known
from concord.studies.sweep.cells import difference
from concord.studies.sweep.pieces import Origin, program
from concord.studies.sweep.specification import Specification

SPECIFICATION = "sweep.json"


class Begun(msgspec.Struct, frozen=True):
    """Which sweep a folder is of, and what computed its pieces."""

    specification: Specification
    versions: dict[str, str]
    commit: str | None
    shards: int | None = None

    @property
    def program(self) -> Origin:
        """Return what computed its pieces."""
        return Origin(self.versions, self.commit)


def folder_of(result: Path) -> Path:
    """Where the pieces of a result wait until all are done."""
    return result.with_name(f"{result.name}.pieces")


def open_store(result: Path, specification: Specification, shards: int = 1) -> Path:
    """Return the folder of the pieces of a result, or of one of its shards; made, or found with
    some of them.

    Raises:
        ValueError: it cannot be made, or it is of another sweep, version or number of shards.
    """
    folder, here = folder_of(result), program()
    make_folder(folder, "--out", result)
    remember(specification)
    if not (folder / SPECIFICATION).exists():
        now = Begun(specification, here.versions, here.commit, shards)
        write_json(folder / SPECIFICATION, now)
        return folder
    before = read_begun(folder)
    check_same(before.specification, specification, result, f"remove {folder} to begin anew")
    if before.program != here:
        raise ValueError(
            f"{folder}: begun by another version of the program (commit {before.commit}); pieces "
            f"of two versions cannot stand side by side; remove it to begin anew"
        )
    if before.shards not in (None, shards):
        raise ValueError(
            f"{folder}: begun with {before.shards} shards, and now {shards} are asked for; keep "
            f"--shard N/{before.shards} (SHARDS={before.shards} of deploy/shards.sh), or remove it"
        )
    return folder


def read_begun(folder: Path) -> Begun:
    """Return which sweep a folder is of.

    Raises:
        ValueError: it is none of a sweep.
    """
    cure = "name the folder of pieces that `concord sweep --shard` has made"
    begun = read_json(folder / SPECIFICATION, Begun, cure, "not a sweep of ours; remove its folder")
    require_known(begun.specification, folder)
    return begun


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


def save_arrays(folder: Path, name: str, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays under a name, whole or not at all."""
    with whole_file(_path(folder, name)) as part, part.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def load_arrays(folder: Path, name: str) -> dict[str, np.ndarray] | None:
    """Return the arrays of a name; None where they are missing or cannot be read."""
    try:
        with _path(folder, name).open("rb") as file, np.load(file) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, NotImplementedError):
        return None


def remove_store(result: Path) -> None:
    """Remove the pieces of a result that is complete."""
    shutil.rmtree(folder_of(result), ignore_errors=True)


def _path(folder: Path, name: str) -> Path:
    return folder / f"{name}.npz"
