"""Shards of a sweep, computed anywhere, as one result."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from concord.studies.sweep.cells import difference
from concord.studies.sweep.pieces import CellParts, pieces_of, program
from concord.studies.sweep.run import assembled, take_found
from concord.studies.sweep.specification import cells_of
from concord.studies.sweep.store import read_begun

if TYPE_CHECKING:
    import xarray


def merge_shards(folders: Sequence[Path], out: Path) -> "xarray.Dataset":
    """Return the result of the sweep whose pieces these folders have, written to `out`.

    The order of the folders, and which piece is in which, change no bit of the result.

    Raises:
        ValueError: folders of different sweeps or of another version, or pieces that are missing.
    """
    first, *others = (read_begun(folder) for folder in folders)
    for folder, other in zip(folders[1:], others, strict=True):
        if changed := difference(first.specification, other.specification):
            raise ValueError(f"{folder} belongs to another sweep than {folders[0]}: {changed}")
        if other.shards != first.shards:
            raise ValueError(
                f"{folder} is one of {other.shards} shards, and {folders[0]} one of "
                f"{first.shards}; merge those of one number"
            )
    for folder, begun in zip(folders, (first, *others), strict=True):
        if begun.program != program():
            raise ValueError(
                f"{folder}: computed by another version of the program (commit {begun.commit}); "
                "merge with the version that computed the shards"
            )
    specification = first.specification
    cells = cells_of(specification)
    parts = {cell.number: CellParts() for cell in cells}
    pieces = pieces_of(specification, cells)
    if missing := take_found(specification, pieces, folders, parts):
        lacking = missing[0]
        raise ValueError(
            f"{len(missing)} of {len(pieces)} pieces are missing, the first of cell "
            f"{cells[lacking.cell].name}, runs {lacking.first} to {lacking.last - 1}; run the "
            "other shards, and name their folders too"
        )
    return assembled(specification, cells, parts, out)
