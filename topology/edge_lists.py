"""Graphs as text: lists of edges and matrices of numbers.

Both are read to a sparse matrix (n, n) whose entry (i, j) is the number on the link by which node i
hears node j, 1 where none is given.
"""

import ast
import csv
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from concord.topology.adjacency import degrees, is_symmetric, links_of, nodes_of
from concord.topology.network import Network
from concord.topology.read_graph import Kind, ReadGraph, from_edges, plain_names

# A matrix as text has a character per pair of nodes at least.
MOST_MATRIX_NODES = 5000
_MOST_MARKET = 1_000_000
_MARKET = re.compile(
    r"%%matrixmarket +matrix +(coordinate|array) +(real|(?:unsigned-)?integer|pattern) +"
    r"(general|symmetric) *"
)

# Names of columns in the header rows of Gephi, pandas, igraph and others.
_SENDERS = ("source", "from", "sender", "fromnodeid", "node1", "src", "u")
_RECEIVERS = ("target", "to", "receiver", "tonodeid", "node2", "dst", "v")
_NUMBERS = ("delivery", "weight", "probability", "quality", "value")


class Row(NamedTuple):
    """A line that has fields: `file:line`, and the fields."""

    where: str
    fields: list[str]


class EdgeColumns(NamedTuple):
    """The columns of an edge's ends and number, with all columns a row has by the header."""

    sender: int = 0
    receiver: int = 1
    number: int | None = 2
    names: tuple[str, ...] = ()

    def of(self, row: Row) -> list[str]:
        """The fields of an edge; a row without the later ones has fewer.

        Raises:
            ValueError: a row with more or other fields than an edge has.
        """
        if self.names and len(row.fields) not in (1, len(self.names)):
            raise ValueError(
                f"{row.where}: {len(row.fields)} columns, but the header has {len(self.names)}; "
                "give each line a field for each column"
            )
        if not self.names and len(row.fields) > 3:
            raise ValueError(
                f"{row.where}: {len(row.fields)} columns; give two nodes and at most one number"
            )
        order = (self.sender, self.receiver, *(() if self.number is None else (self.number,)))
        return [row.fields[k] for k in order if k < len(row.fields)]


def read_text(file: Path) -> ReadGraph:
    """The graph of a list of edges or of a matrix.

    A file is a matrix if it has a row for each column, and, of up to three nodes or outside CSV,
    0 on its diagonal. Its columns may have names in a row before, and its rows in a column.

    Raises:
        ValueError: naming file, line and cure.
    """
    rows = _rows(file)
    return _matrix(file, rows) if _is_matrix(file, rows) else _edge_list(rows)


def read_market(file: Path) -> ReadGraph:
    """The graph of a matrix in Matrix Market form.

    Raises:
        ValueError: naming file, entry and cure.
    """
    try:
        given = _market_matrix(file.read_text(encoding="utf-8", errors="replace"))
    except ValueError as error:
        raise ValueError(f"{file}: not Matrix Market ({error}); export the matrix again") from None
    height, width = nodes_of(given), nodes_of(given.T)
    if height != width:
        raise ValueError(
            f"{file}: a matrix of {height} rows and {width} columns; give a "
            "square matrix with one row per node"
        )
    given.eliminate_zeros()
    coordinates = given.tocoo()
    for i, j, value in zip(coordinates.row, coordinates.col, coordinates.data, strict=True):
        if i == j:
            raise ValueError(
                f"{file}: entry ({i + 1}, {j + 1}): node {i + 1} is linked to itself; put 0 on the "
                "diagonal"
            )
        _quality(str(value), f"{file}: entry ({i + 1}, {j + 1})")
    names = tuple(plain_names(nodes_of(given)))
    return ReadGraph(csr_array(given, dtype=float), names, Kind.MATRIX)


def _market_matrix(text: str) -> csr_array:
    """Return the matrix of a file; the reader of scipy ends the process on some damaged ones.

    Raises:
        ValueError: naming what is wrong.
    """
    head, *lines = text.splitlines() or [""]
    if (found := _MARKET.fullmatch(head.lower())) is None:
        raise ValueError(f"its first line is {head[:80]!r}")
    form, field, symmetry = found.groups()
    is_array, is_symmetric = form == "array", symmetry == "symmetric"
    sizes, *rows = [line for line in lines if line.strip() and line[0] != "%"] or [""]
    height, width, *told = map(int, sizes.split())
    if len(told) + is_array != 1 or min(height, width) < 0 or max(height, width) > _MOST_MARKET:
        raise ValueError(f"its sizes are {sizes[:80]!r}")
    count = told[0] if told else height * (height + 1) // 2 if is_symmetric else height * width
    if count != len(rows) or (is_symmetric and height != width):
        raise ValueError(f"{height} x {width} nodes, {count} entries; {len(rows)} are there")
    entries = np.loadtxt(rows, ndmin=2) if rows else np.zeros((0, 3))
    if is_array:  # Column by column; of a symmetric matrix from the diagonal downwards.
        j, i = np.triu_indices(width, 0 if is_symmetric else -width, height)
        values = entries.ravel()
    else:
        i, j = entries[:, :2].T - 1
        values = np.ones(count) if field == "pattern" else entries[:, 2:].ravel()
    within = (i >= 0) & (i < height) & (j >= 0) & (j < width) & (i % 1 + j % 1 == 0)
    for row in np.flatnonzero(~within):
        raise ValueError(f"entry {rows[row][:80]!r} is outside of the matrix")
    if values.size != count:
        raise ValueError(f"its entries have {entries.shape[1]} numbers")
    if is_symmetric:
        below = i != j
        i, j, values = np.r_[i, j[below]], np.r_[j, i[below]], np.r_[values, values[below]]
    return csr_array((values, (i.astype(int), j.astype(int))), shape=(height, width))


def write_edge_list(file: Path, network: Network) -> None:
    """Writes a list that `read_text` reads back."""
    adjacency, delivery = network.adjacency, network.delivery
    hearer, heard = links_of(adjacency)
    once = delivery is None and is_symmetric(adjacency)
    numbers = [""] * len(hearer) if delivery is None else [f" {p:.17g}" for p in delivery]
    lines = [
        f"{sender} {receiver}{number}\n"
        for receiver, sender, number in zip(hearer, heard, numbers, strict=True)
        if not once or sender < receiver
    ]
    silent = (degrees(adjacency) == 0) & (degrees(csr_array(adjacency.T)) == 0)
    alone = [f"{node}\n" for node in np.flatnonzero(silent)]
    file.write_text("".join(lines + alone))


def write_matrix(file: Path, network: Network) -> None:
    """Writes a matrix that `read_text` reads back.

    Raises:
        ValueError: for more than `MOST_MATRIX_NODES` nodes.
    """
    nodes = nodes_of(network.adjacency)
    if nodes > MOST_MATRIX_NODES:
        raise ValueError(
            f"{file}: a matrix of {nodes} nodes has {nodes**2} entries; write .edges or .graphml "
            f"for more than {MOST_MATRIX_NODES} nodes"
        )
    matrix: NDArray = np.zeros((nodes, nodes))
    matrix[links_of(network.adjacency)] = 1 if network.delivery is None else network.delivery
    np.savetxt(file, matrix, fmt="%.17g", delimiter=",")


def _rows(file: Path) -> list[Row]:
    """The lines with fields; `#` ends a line, `%` begins one without fields."""
    text = file.read_text(encoding="utf-8-sig", errors="replace")  # spreadsheets write a mark first
    if "\0" in text:
        raise ValueError(f"{file}: not text in UTF-8; save the file as text in UTF-8")
    lines = [
        (f"{file}:{number}", _without_comment(line))
        for number, line in enumerate(text.splitlines(), start=1)
    ]
    lines = [(where, line) for where, line in lines if line]
    heads = [line.partition("{")[0] for _, line in lines]
    separator = next((mark for mark in ",;" if any(mark in head for head in heads)), None)
    if separator is None and heads and all("\t" in head for head in heads):
        separator = "\t"
    return [Row(where, _fields(line, separator, where)) for where, line in lines]


def _without_comment(line: str) -> str:
    if line.lstrip().startswith("%"):
        return ""
    head, brace, data = line.partition("{")
    return head.partition("#")[0].strip() if "#" in head else (head + brace + data).strip()


def _fields(line: str, separator: str | None, where: str) -> list[str]:
    """The fields of a line; a dict of an edge's data, as networkx writes it, is its number."""
    head, brace, rest = line.partition("{")
    if separator is None:
        fields = head.split()
    else:
        fields = [field.strip() for field in next(csv.reader([head], delimiter=separator), [])]
    if not brace:
        return fields
    try:
        data = dict(ast.literal_eval(brace + rest))
    except (ValueError, TypeError, SyntaxError):
        raise ValueError(
            f"{where}: {brace + rest!r} is no data of an edge as networkx writes it; write {{}} or "
            "leave it out"
        ) from None
    fields = [field for field in fields if field]
    number = next((data[name] for name in _NUMBERS if name in data), None)
    return fields if number is None else [*fields, str(number)]


def _is_matrix(file: Path, rows: list[Row]) -> bool:
    size, widths = len(rows), {len(row.fields) for row in rows}
    is_csv = file.suffix.lower() == ".csv"
    first = rows[0].fields if rows else []
    if not first:
        return is_csv
    if len(first) > 1 and not first[0]:
        return True  # The corner above the names of rows is empty.
    if is_csv and (_is_word(first[0]) or (widths <= {1, 2, 3} and size > max(widths))):
        return False
    is_square = widths == {size} and not any(map(_is_word, (f for row in rows for f in row.fields)))
    if not is_square:
        return is_csv
    if size == 3 and any(float(row.fields[k]) for k, row in enumerate(rows)):
        # Three links with a number each, unless one of them would lead from a node to itself.
        return is_csv and any(row.fields[0] == row.fields[1] for row in rows)
    return is_csv or size > 2


def _matrix(file: Path, rows: list[Row]) -> ReadGraph:
    """The graph of a matrix, whose rows and columns may have names."""
    names: list[str] | None = None
    if rows and len(rows[0].fields) > 1 and not rows[0].fields[0]:
        names = rows[0].fields[1:]
        rows = [Row(where, fields[1:]) for where, fields in rows[1:]]
    numbers = [(row.where, [_quality(field, row.where) for field in row.fields]) for row in rows]
    for where, row in numbers:
        if len(row) != len(rows):
            raise ValueError(
                f"{where}: {len(row)} entries in a matrix of {len(rows)} rows; "
                "give a square matrix with one row per node"
            )
    matrix = np.array([row for _, row in numbers]).reshape(len(rows), len(rows))
    for node in np.flatnonzero(matrix.diagonal()):
        raise ValueError(f"{rows[node].where}: node {node} is linked to itself; put 0 on the "
                         "diagonal")  # fmt: skip
    return ReadGraph(csr_array(matrix), tuple(names or plain_names(len(rows))), Kind.MATRIX)


def _edge_list(rows: list[Row]) -> ReadGraph:
    columns = _header(rows)
    rows = rows[1:] if columns.names else rows
    edges: list[tuple[str, str, float]] = []
    labels: dict[str, None] = {}
    width = None
    for row in rows:
        fields = columns.of(row)
        if len(fields) > 1 and len(fields) != (width := width or len(fields)):
            raise ValueError(
                f"{row.where}: {len(fields)} columns, but {width} on the lines before (cut off?); "
                "give every link a number or none"
            )
        ends = [_label(field, row.where) for field in fields[:2]]
        labels.update(dict.fromkeys(ends))
        quality = _quality(fields[2], row.where) if len(fields) == 3 else 1.0
        if len(ends) == 2 and quality > 0:
            edges.append((ends[0], ends[1], quality))
    found = from_edges(labels, edges, Kind.LIST)
    read = (columns.sender, columns.receiver, columns.number)
    if unread := [name for k, name in enumerate(columns.names) if k not in read]:
        return found._replace(notes=(*found.notes, f"its columns {', '.join(unread)} are not read"))
    return found


def _header(rows: list[Row]) -> EdgeColumns:
    """The columns by the names in the first row, if it has names.

    It has if it names sender and receiver, or if all ends below are numbers and its own are words.
    """
    names = [name.lower() for name in rows[0].fields] if rows else []
    if len(names) < 2:
        return EdgeColumns()
    sender = next((names.index(name) for name in _SENDERS if name in names), None)
    receiver = next((names.index(name) for name in _RECEIVERS if name in names), None)
    if sender is None or receiver is None:
        ends = [end for row in rows[1:] for end in row.fields[:2]]
        if not ends or not all(map(_is_word, names[:2])) or any(map(_is_word, ends)):
            return EdgeColumns()
        sender, receiver = 0, 1
    number = next((names.index(name) for name in _NUMBERS if name in names), None)
    return EdgeColumns(sender, receiver, number, tuple(rows[0].fields))


def _label(field: str, where: str) -> str:
    if not field:
        raise ValueError(f"{where}: a node without a name; give every line two nodes")
    return str(int(field)) if field.isdecimal() else field


def _is_word(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return True
    return False


def _quality(field: str, where: str) -> float:
    try:
        quality = float(field)
    except ValueError:
        quality = np.nan
    if not 0 <= quality < np.inf:
        raise ValueError(
            f"{where}: {field.strip()!r} is not a finite number of 0 or more; give 0 for no link"
        )
    return quality
