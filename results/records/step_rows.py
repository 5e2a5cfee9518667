"""Rows of numbers of steps and nodes, kept in the order in which they came, and read as arrays."""

from array import array
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

# Few: a forged message may ask for rows of a megabyte.
_FIRST_ROWS = 16


class StepRows:
    """A row of numbers for each (step, node), in fields of given shapes.

    The messages of a long run, kept as objects, take several times the memory of its recording. A
    row takes 8 bytes a number. Rows lie in blocks, each twice as long as the one before, so that no
    row moves and a step far beyond all others takes no more memory than any other.
    """

    def __init__(self, nodes: int, fields: Mapping[str, tuple[int, ...]]) -> None:
        """Args:
        nodes: number of nodes.
        fields: shape of each field.
        """
        self._nodes, self._shapes = nodes, dict(fields)
        self._type = np.dtype([(name, np.float64, shape) for name, shape in fields.items()])
        self._blocks: list[np.ndarray] = []
        # By step, the row of each node; -1 for none.
        self._places: dict[int, array[int]] = {}
        self._rows = self._room = 0

    def put(self, step: int, node: int, **fields: Any) -> bool:
        """Keep a row, in place of an older one of this step and node; None is NaN.

        Return whether it was kept: a field of another shape than it should have is not.
        """
        values = {name: np.asarray(one, dtype=np.float64) for name, one in fields.items()}
        if any(one.shape != self._shapes[name] for name, one in values.items()):
            return False
        places = self._places.get(step)
        if places is None:
            places = self._places[step] = array("q", [-1] * self._nodes)
        if places[node] < 0:
            places[node] = self._new_row()
        row = self.row(step, node)
        for name in self._shapes:
            row[name] = values.get(name, np.nan)
        return True

    def row(self, step: int, node: int) -> Any:
        """Return the fields of a row that is kept."""
        place = self._places[step][node]
        first, block = next(one for one in self._with_firsts(newest=True) if one[0] <= place)
        return block[place - first]

    def _new_row(self) -> int:
        if self._rows == self._room:
            self._blocks.append(np.empty(_FIRST_ROWS << len(self._blocks), dtype=self._type))
            self._room += len(self._blocks[-1])
        self._rows += 1
        return self._rows - 1

    def _with_firsts(self, newest: bool = False) -> Iterator[tuple[int, np.ndarray]]:
        """Yield each block with the number of its first row, the newest first if asked for."""
        places = range(len(self._blocks))
        for place in reversed(places) if newest else places:
            yield _FIRST_ROWS * ((1 << place) - 1), self._blocks[place]

    def __contains__(self, place: tuple[int, int]) -> bool:
        """Whether there is a row for this (step, node)."""
        step, node = place
        return step in self._places and self._places[step][node] >= 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._rows

    @property
    def steps(self) -> int:
        """One more than the last step of which there is a row."""
        return 1 + max(self._places, default=-1)

    def rows(self, there: np.ndarray) -> np.ndarray:
        """Return the number of the row (steps, N) of each step and node; -1 where there is none, or
        `there` (steps, N) is False."""
        found = np.full(there.shape, -1)
        known = [step for step in self._places if step < len(there)]
        for step in known:
            found[step] = self._places[step]
        return np.where(there, found, -1)

    def field(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return a field (steps, N, ...) of these `rows`; NaN where there is none."""
        found = np.full((*rows.shape, *self._shapes[name]), np.nan)
        for first, block in self._with_firsts():
            here = (rows >= first) & (rows < first + len(block))
            found[here] = block[name][rows[here] - first]
        return found
